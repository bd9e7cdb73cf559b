"""Sharing a claim's report for a time, and what the holders of its address see without an API key.

An address holds a token, of which only the digest is kept.
"""

import json
import secrets
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import APIRouter, Response
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, ConfigDict, Field

from service.claims.annex import annex_html
from service.claims.endpoints import ZIP, SignedClaim, pack_file, packs, report_page, signed
from service.claims.pack import shown_in_pack
from service.claims.schema import OwnerStatement
from service.clock import now
from service.core import Service
from service.db import Database, missing, own
from service.db.schema import claims, shares
from service.http.access import Core, Follower, Verifier, visible
from service.http.error_responses import OF_OWN, responses
from service.http.forms import WHOLE, RequestBody
from service.http.results import Time
from service.problems import Problem
from service.trust import audit
from service.trust.api_keys import Caller

router = APIRouter(tags=["shares"])
TOKEN_BYTES = 32
MOST = 20
"""Addresses of one claim at a time."""


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
    token, row = _share(core, caller, visible(core, caller, claims, claim_id), body.days)
    response.headers["Cache-Control"] = "no-store"
    return MadeShare.model_validate(row._asdict() | {"url": f"{core.public_url()}/shared/{token}"})


@router.get("/v1/claims/{claim_id}/shares", operation_id="listShares", responses=OF_OWN)
def list_shares(claim_id: str, core: Core, caller: Follower) -> ShareList:
    """Active shares of a claim; the addresses themselves are not stored."""
    visible(core, caller, claims, claim_id)
    with core.db.read() as connection:
        return ShareList(items=[Share.model_validate(row) for row in _standing(connection, claim_id)])


@router.delete("/v1/shares/{share_id}", status_code=204, operation_id="revokeShare", responses=OF_OWN)
def revoke_share(share_id: str, core: Core, caller: Verifier) -> None:
    """Revoke a share: its address shows nothing from now on."""
    row = own(core.db, shares, caller.tenant, share_id)
    visible(core, caller, claims, row.claim)
    with core.db.exclusive() as connection:
        if connection.execute(sa.delete(shares).where(shares.c.id == row.id)).rowcount == 0:  # another was faster
            raise missing(shares, row.id)
        facts = {"share": row.id, "api_key": caller.key_id}
        audit.append(connection, caller.tenant, "claim.share_revoked", facts, row.claim)


@router.get(
    "/shared/{token}", operation_id="sharedReport", response_class=HTMLResponse, responses=responses("not-found")
)
def shared_report(token: str, core: Core) -> str:
    """The report, for anyone with its address."""
    return report_page(core, shared(core.db, token))


@router.get(
    "/shared/{token}/annex", operation_id="sharedAnnex", response_class=HTMLResponse, responses=responses("not-found")
)
def shared_annex(token: str, core: Core) -> str:
    """How often the method errs, for anyone with the address of the report."""
    return annex_html(json.loads(shared(core.db, token).document))


@router.get("/shared/{token}/claim.json", operation_id="sharedClaim", responses=responses("not-found"))
def shared_claim(token: str, core: Core) -> SignedClaim:
    """The claim, for anyone with the address of its report."""
    return signed(shared(core.db, token))


@packs.get(
    "/shared/{token}/pack",
    operation_id="sharedPack",
    response_class=Response,
    responses={**ZIP, **responses("not-found", "conflict")},
)
def shared_pack(token: str, core: Core) -> Response:
    """The pack, for anyone with the address of the report. It takes no note: a note is the owner's statement."""
    return pack_file(core, shared(core.db, token), OwnerStatement())


def _share(service: Service, caller: Caller, claim: Any, days: int) -> tuple[str, Any]:
    """Token and row of a new share of a claim (its row). The log says who shared what, and not the token.

    conflict for a claim whose report shows the unmarked original, as those of earlier versions do; budget-exceeded
    where it has MOST shares.
    """
    pictures = json.loads(claim.pictures)
    if set(shown_in_pack(pictures)) != set(pictures):
        text = "the report of this claim shows the unmarked original and cannot be shared; check the suspect again"
        raise Problem("conflict", text)
    token, share_id = secrets.token_urlsafe(TOKEN_BYTES), f"sh_{secrets.token_hex(12)}"
    until = (datetime.now(UTC) + timedelta(days=days)).isoformat(timespec="microseconds")
    values = {"id": share_id, "tenant": caller.tenant, "claim": claim.id, "digest": _digest(token)}
    with service.db.exclusive() as connection:
        if len(_standing(connection, claim.id)) >= MOST:
            raise Problem("budget-exceeded", f"{MOST} addresses of this claim stand: revoke one")
        connection.execute(shares.insert().values(**values, created_at=now(), expires_at=until))
        facts = {"share": share_id, "api_key": caller.key_id, "expires_at": until}
        audit.append(connection, caller.tenant, "claim.shared", facts, claim.id)
        row = connection.execute(sa.select(shares).where(shares.c.id == share_id)).one()
    return token, row


def shared(db: Database, token: str) -> Any:
    """The row of the claim that a token is for; not-found alike for unknown, expired and revoked ones."""
    this = (shares.c.digest == _digest(token)) & (shares.c.expires_at > now())
    row = db.query(sa.select(claims).join(shares, shares.c.claim == claims.c.id).where(this)).first()
    if row is None:
        raise Problem("not-found", "there is nothing at this address, or not any more")
    return row


def sweep(db: Database) -> int:
    """Forget shares that have expired, and those of claims that are gone; how many."""
    gone = (shares.c.expires_at <= now()) | shares.c.claim.not_in(sa.select(claims.c.id))
    return db.change(sa.delete(shares).where(gone))


def _standing(connection: sa.Connection, claim_id: str) -> list[Any]:
    this = (shares.c.claim == claim_id) & (shares.c.expires_at > now())
    return list(connection.execute(sa.select(shares).where(this).order_by(shares.c.created_at.desc(), shares.c.id)))


def _digest(token: str) -> str:
    """A plain hash is enough: 256 random bits cannot be guessed."""
    return sha256(token.encode()).hexdigest()
