"""/v1/claims, and the public keys that they are checked with."""

import base64
import json
import re
from typing import Annotated, Any, Literal

import sqlalchemy as sa
from fastapi import APIRouter, Query, Response
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, Field

from engine.present.wording import named_copy
from service.claims.annex import annex_html
from service.claims.document import Summary, document_words, summary_of
from service.claims.pack import make_pack, shown_in_pack
from service.claims.report import report_html
from service.claims.schema import OwnerStatement
from service.core import Service
from service.db import holding, page
from service.db.schema import assets, claims
from service.http.access import NO_ZERO, Admin, After, Core, Follower, Limit, Listed, Reader, Words, visible
from service.http.error_responses import OF_LIST, OF_OWN, responses
from service.http.file_responses import TEXT, one_file
from service.http.results import Time
from service.trust.commitments import forget
from service.trust.signing import jwks

router = APIRouter(tags=["claims"])
packs = APIRouter(tags=["claims"])
SOUGHT = "Part of a suspect's file name, of the claim's or asset's id, label or copy name; or a suspect's SHA-256."
JWS_TYPE = "application/jose"
PACK_TYPE = "application/zip"
ZIP = one_file(PACK_TYPE, "A ZIP")


class SignedClaim(BaseModel):
    """A claim: the document, and the signature over it."""

    document: dict[str, Any] = Field(description="What is signed (see docs/CLAIM.md).")
    jws: str = Field(description="Compact JWS over the document, Ed25519.")
    timestamp: str | None = Field(description="RFC 3161 token of the JWS, base64; null where none was made.")
    summary: Summary


class ClaimSummary(BaseModel):
    """A claim in a list."""

    id: str
    suspects: list[str] = Field(description="Names of the suspect's files; empty for claims of earlier versions.")
    asset_id: str | None
    asset_label: str | None = Field(description="null where no asset was recognised, or it was deleted.")
    copy_name: str | None = Field(description="Recipient of the copy that the mark names; null where it names none.")
    verdict: str
    headline: str
    finding: str
    log10_false_claim: float
    created_at: Time


class ClaimList(Listed[ClaimSummary]):
    """A page of claims, newest first."""


class KeySet(BaseModel):
    """Public keys (RFC 7517)."""

    keys: list[dict[str, Any]]


@router.get("/v1/claims", operation_id="listClaims", responses=OF_LIST)
def list_claims(
    core: Core,
    caller: Reader,
    limit: Limit = 20,
    after: After = "",
    verdict: Annotated[Literal["marked", "not_marked", "inconclusive"] | None, Query(description="Verdict.")] = None,
    asset: Annotated[str, Query(max_length=64, pattern=NO_ZERO, description="About the asset of this id.")] = "",
    q: Annotated[Words, Query(description=SOUGHT)] = "",
) -> ClaimList:
    """Claims of this tenant, newest first."""
    given = ((claims.c.verdict, verdict), (claims.c.asset, asset))
    where = sa.and_(_about(caller.tenant, q), *(column == value for column, value in given if value))
    with core.db.read() as connection:
        rows, following = page(connection, claims, caller.tenant, limit, after, where=where)
        labels = _labels(connection, rows)
    return ClaimList(items=[_summary(row, labels.get(row.asset)) for row in rows], next=following)


@router.get(
    "/v1/claims/{claim_id}.jws",
    operation_id="getClaimJws",
    response_class=Response,
    responses={**one_file(JWS_TYPE, "Compact JWS", TEXT), **OF_OWN},
)
def get_jws(claim_id: str, core: Core, caller: Follower) -> Response:
    """The signed claim alone, to hand to a third party."""
    row = visible(core, caller, claims, claim_id)
    headers = {"Content-Disposition": f'attachment; filename="{row.id}.jws"'}
    return Response(row.jws, media_type=JWS_TYPE, headers=headers)


@router.get("/v1/claims/{claim_id}", operation_id="getClaim", responses=OF_OWN)
def get_claim(claim_id: str, core: Core, caller: Follower) -> SignedClaim:
    """A claim."""
    return signed(visible(core, caller, claims, claim_id))


@router.delete("/v1/claims/{claim_id}", status_code=204, operation_id="deleteClaim", responses=OF_OWN)
def delete_claim(claim_id: str, core: Core, caller: Admin) -> None:
    """Delete a claim and its pictures here. Copies handed out stay valid; the log keeps that it was issued."""
    forget(core.db, claims, caller.tenant, claim_id)


@router.get("/v1/claims/{claim_id}/report", operation_id="getReport", response_class=HTMLResponse, responses=OF_OWN)
def get_report(claim_id: str, core: Core, caller: Follower) -> str:
    """The claim as one page to read, print and send: pictures, bits, bound, and how to check the signature."""
    return report_page(core, visible(core, caller, claims, claim_id))


@router.get("/v1/claims/{claim_id}/annex", operation_id="getAnnex", response_class=HTMLResponse, responses=OF_OWN)
def get_annex(claim_id: str, core: Core, caller: Follower) -> str:
    """How often the method errs, as one page beside the report: what was tested, error rates, known limits. Not signed.

    Its numbers are of the service's version; where another version made the claim, the page says so.
    """
    return annex_html(json.loads(visible(core, caller, claims, claim_id).document))


@packs.get(
    "/v1/claims/{claim_id}/pack",
    operation_id="getPack",
    response_class=Response,
    responses={**ZIP, **responses("unauthorized", "forbidden", "not-found", "conflict", "invalid-request")},
)
def get_pack(claim_id: str, core: Core, caller: Follower, given: Annotated[OwnerStatement, Query()]) -> Response:
    """Documents for a platform: comparison, finding in words, notice with blanks, and the signed claim."""
    return pack_file(core, visible(core, caller, claims, claim_id), given)


@router.get("/.well-known/jwks.json", operation_id="jwks", responses=responses())
def key_set(core: Core, response: Response) -> KeySet:
    """Public keys that verify claims, retired ones too."""
    response.headers["Cache-Control"] = "public, max-age=300"
    return KeySet(keys=jwks(core.db)["keys"])


def signed(row: Any) -> SignedClaim:
    """The claim of a row of the table `claims`."""
    stamp = base64.b64encode(row.timestamp).decode() if row.timestamp else None
    document = json.loads(row.document)
    return SignedClaim(document=document, jws=row.jws, timestamp=stamp, summary=summary_of(document))


def report_page(service: Service, row: Any) -> str:
    """The claim as one page."""
    pictures = {name: service.blobs.read(digest) for name, digest in json.loads(row.pictures).items()}
    return report_html(json.loads(row.document), row.jws, pictures, row.timestamp)


def pack_file(service: Service, row: Any, given: OwnerStatement) -> Response:
    """The claim's pack; conflict where it recognised nothing."""
    document, digests = json.loads(row.document), json.loads(row.pictures)
    pictures = {name: service.blobs.read(digests[name]) for name in shown_in_pack(digests)}
    headers = {"Content-Disposition": f'attachment; filename="{row.id}-pack.zip"', "Cache-Control": "no-store"}
    return Response(make_pack(document, row.jws, pictures, row.timestamp, given), headers=headers, media_type=PACK_TYPE)


def _about(tenant: str, text: str) -> sa.ColumnElement[bool]:
    """Claims whose names, ids, asset's label or copy name hold a text; of a digest: whose document names it, too."""
    if not text:
        return sa.true()
    named = sa.select(assets.c.id).where((assets.c.tenant == tenant) & holding(text, assets.c.label, assets.c.copy))
    found = holding(text, claims.c.id, claims.c.names, claims.c.asset) | claims.c.asset.in_(named)
    return found | claims.c.document.contains(text.lower()) if re.fullmatch("[0-9a-fA-F]{64}", text) else found


def _labels(connection: sa.Connection, rows: list[Any]) -> dict[str, str]:
    """Labels of the assets of claims that are there, by id."""
    known = sa.select(assets.c.id, assets.c.label).where(assets.c.id.in_({row.asset for row in rows if row.asset}))
    return {row.id: row.label for row in connection.execute(known)}


def _summary(row: Any, label: str | None) -> ClaimSummary:
    document = json.loads(row.document)
    words = document_words(document)
    said = {
        "headline": words.headline,
        "finding": words.finding,
        "suspects": row.names.split("\n") if row.names else [],
    }
    signed = {name: document[name] for name in ("verdict", "log10_false_claim")}
    about = {"asset_id": row.asset, "asset_label": label, "copy_name": named_copy(document) or None}
    return ClaimSummary(id=row.id, created_at=row.created_at, **about, **said, **signed)
