"""Sharing a claim's report for a time, and what the holders of its address see without an API key."""

from typing import Annotated

from fastapi import APIRouter, Response
from pydantic import BaseModel, ConfigDict, Field

from service.claims import shares
from service.claims.endpoints import packs
from service.claims.presentation import PAGE, ZIP, SignedClaim, pack_file, report_page, signed
from service.claims.schema import OwnerStatement
from service.db import own, schema
from service.http.access import Core, Follower, Verifier, visible
from service.http.error_responses import OF_OWN, responses
from service.http.forms import WHOLE, RequestBody
from service.http.results import Time

router = APIRouter(tags=["shares"])


class NewShare(RequestBody):
    """Lifetime of a share."""

    model_config = ConfigDict(strict=True, json_schema_extra={"examples": [{"days": 14}]})
    days: Annotated[int, Field(ge=1, le=90), WHOLE] = Field(14, description="Days until the address expires.")


FOR_A_WHILE = NewShare()


class Share(BaseModel):
    """An address that shows a claim."""

    model_config = ConfigDict(from_attributes=True)
    id: str
    claim_id: str = Field(validation_alias="claim")
    created_at: Time
    expires_at: Time


class MadeShare(Share):
    """A share just made."""

    url: str = Field(
        description="Link to send; a path alone where the service has no public address. It is shown only once;"
        " everyone who has it can read the report."
    )


class ShareList(BaseModel):
    """Active shares, newest first."""

    items: list[Share]


@router.post(
    "/v1/claims/{claim_id}/share",
    status_code=201,
    operation_id="shareClaim",
    responses=responses(
        "malformed-request", "unauthorized", "forbidden", "not-found", "conflict", "invalid-request", "budget-exceeded"
    ),
)
def share_claim(
    claim_id: str, core: Core, caller: Verifier, response: Response, body: NewShare = FOR_A_WHILE
) -> MadeShare:
    """Make an address that shows the report without an API key, for some days or until it is revoked.

    Needs the scope `verify` and access to the claim. A share outlives its API key, so a key that only reads may not
    make one.
    """
    token, row = shares.share(core, caller, visible(core, caller, schema.claims, claim_id), body.days)
    response.headers["Cache-Control"] = "no-store"
    return MadeShare.model_validate(row._asdict() | {"url": f"{core.public_url()}/shared/{token}"})


@router.get("/v1/claims/{claim_id}/shares", operation_id="listShares", responses=OF_OWN)
def list_shares(claim_id: str, core: Core, caller: Follower) -> ShareList:
    """Active shares of a claim; the addresses themselves are not stored."""
    visible(core, caller, schema.claims, claim_id)
    return ShareList(items=[Share.model_validate(row) for row in shares.shares_of(core.db, claim_id)])


@router.delete("/v1/shares/{share_id}", status_code=204, operation_id="revokeShare", responses=OF_OWN)
def revoke_share(share_id: str, core: Core, caller: Verifier) -> None:
    """Revoke a share: its address shows nothing from now on."""
    row = own(core.db, schema.shares, caller.tenant, share_id)
    visible(core, caller, schema.claims, row.claim)
    shares.revoke(core.db, caller, row)


@router.get(
    "/shared/{token}",
    operation_id="sharedReport",
    response_class=Response,
    responses={**PAGE, **responses("not-found")},
)
def shared_report(token: str, core: Core) -> Response:
    """The report, for anyone with its address."""
    return report_page(core, shares.shared(core.db, token))


@router.get("/shared/{token}/claim.json", operation_id="sharedClaim", responses=responses("not-found"))
def shared_claim(token: str, core: Core) -> SignedClaim:
    """The claim, for anyone with the address of its report."""
    return signed(shares.shared(core.db, token))


@packs.get(
    "/shared/{token}/pack",
    operation_id="sharedPack",
    response_class=Response,
    responses={**ZIP, **responses("not-found", "conflict")},
)
def shared_pack(token: str, core: Core) -> Response:
    """The pack, for anyone with the address of the report. It takes no note: a note is the owner's statement."""
    return pack_file(core, shares.shared(core.db, token), OwnerStatement())
