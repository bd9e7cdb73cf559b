"""POST /v1/disputes: two assets carry each other's claims; who was first?

The operator may start a dispute, or both owners. A consent is an entry of the audit log; it reveals nothing about
whether another tenant's asset exists.
"""

import asyncio
import json
from collections.abc import Mapping
from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import APIRouter, Response
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, ConfigDict, Field, JsonValue

from engine.present.dispute_text import dispute_page, dispute_words
from service.core import Service
from service.db.schema import assets, jobs
from service.http.access import Core, Disputer, Party
from service.http.budgets import spend
from service.http.error_responses import OF_OWN
from service.http.forms import RequestBody
from service.http.job_responses import JOB_RESPONSES, JobView, Prefer, RetryKey, respond, submit
from service.http.results import DisputeResult
from service.jobs.port import Job, State
from service.problems import Problem
from service.trust import audit
from service.trust.api_keys import OPERATOR, Caller

router = APIRouter(prefix="/v1/disputes", tags=["disputes"])
AssetId = Annotated[str, Field(min_length=1, max_length=64)]


_EXAMPLE: JsonValue = {"asset_a": "as_d40313a36c48f4baf73fb30a", "asset_b": "as_77f1ce0c1f4b2d2a5a3f9c10"}


class DisputeRequest(RequestBody):
    """The two registered assets of a dispute."""

    model_config = ConfigDict(json_schema_extra={"examples": [_EXAMPLE]})
    asset_a: AssetId
    asset_b: AssetId


class Settled(BaseModel):
    """A settled dispute: the document, and the signature over it."""

    headline: str
    finding: str
    reasons: list[str]
    document: dict[str, Any] = Field(description="What is signed (see docs/CLAIM.md).")
    jws: str = Field(description="Compact JWS over the document, Ed25519.")


@router.post("", status_code=202, operation_id="dispute", response_model=JobView, responses=JOB_RESPONSES)
async def dispute(
    body: DisputeRequest, core: Core, caller: Disputer, prefer: Prefer = None, idempotency_key: RetryKey = None
) -> Response:
    """Find out whose mark is in the other's original. The operator may request this, or both owners: the first of them
    leaves a consent (409), the second starts the job."""
    job = await asyncio.to_thread(_submit, core, caller, body, idempotency_key)
    return await respond(core, job, prefer)


@router.get("/{dispute_id}", operation_id="getDispute", responses=OF_OWN)
def get_dispute(dispute_id: str, core: Core, caller: Party) -> Settled:
    """A settled dispute, for both owners and the operator."""
    result = _found(core, caller, dispute_id)
    words = dispute_words(result["document"]["finding"])
    said = {"headline": words.headline, "finding": words.finding, "reasons": list(words.reasons)}
    return Settled(document=result["document"], jws=result["jws"], **said)


@router.get("/{dispute_id}/report", operation_id="getDisputeReport", response_class=HTMLResponse, responses=OF_OWN)
def get_dispute_report(dispute_id: str, core: Core, caller: Party) -> str:
    """The dispute as one page to read, print and send."""
    result = _found(core, caller, dispute_id)
    return dispute_page(result["document"]["finding"], result["jws"])


def _submit(core: Service, caller: Caller, body: DisputeRequest, retry_key: str | None) -> Job:
    request = {"assets": [body.asset_a, body.asset_b]}

    def make() -> Mapping[str, list[str]]:
        limit = core.settings.verifies_per_hour
        spend(core.db, f"verify:{caller.key_id}", limit, 1, "verify jobs of this API key")
        agreed(core, caller, (body.asset_a, body.asset_b))
        return request

    return submit(core, caller, "dispute", retry_key, {"dispute": request}, make)


def _found(core: Service, caller: Caller, dispute_id: str) -> DisputeResult:
    """Result of a dispute that the caller is a party of; "not-found" otherwise."""
    missing = Problem("not-found", f"there is no dispute {dispute_id!r}")
    job_id = "job_" + dispute_id.removeprefix("di_")
    with core.db.read() as connection:
        row = connection.execute(jobs.select().where(jobs.c.id == job_id, jobs.c.kind == "dispute")).one_or_none()
        if row is None or row.state != State.SUCCEEDED or not dispute_id.startswith("di_"):
            raise missing
        ids = json.loads(row.request)["assets"]
        owners = connection.execute(sa.select(assets.c.tenant).where(assets.c.id.in_(ids))).scalars().all()
    if OPERATOR not in caller.scopes and caller.tenant not in owners:
        raise missing
    result: DisputeResult = json.loads(row.result)
    return result


CONSENTED = "dispute.consented"


def agreed(service: Service, caller: Caller, pair: tuple[str, str]) -> None:
    """Note the caller's consent to a dispute about two assets; "conflict" while the other owner's is missing.

    "not-found" where neither asset is the caller's; a "conflict", too, where both are one.
    """
    if pair[0] == pair[1]:
        raise Problem("conflict", "a dispute is about two assets")
    owners = service.db.query(sa.select(assets.c.tenant).where(assets.c.id.in_(pair))).scalars().all()
    if OPERATOR in caller.scopes:
        if len(owners) < 2:
            raise Problem("not-found", "there are no two such assets")
        return
    if caller.tenant not in owners:
        raise Problem("not-found", "neither asset is yours")
    with service.db.exclusive() as connection:
        if not _has_consented(connection, caller.tenant, pair):
            payload = {"assets": sorted(pair)}
            audit.append(connection, caller.tenant, CONSENTED, payload, _subject(caller.tenant, pair))
        tenants = set(owners) if len(owners) == 2 else {caller.tenant, None}
        waiting = [each for each in tenants if each is None or not _has_consented(connection, each, pair)]
    if waiting:
        text = "your consent is noted; the dispute begins when the owner of the other asset asks for it, too"
        raise Problem("conflict", text)


def _has_consented(connection: sa.Connection, tenant: str, pair: tuple[str, str]) -> bool:
    return audit.find(connection, CONSENTED, _subject(tenant, pair)) is not None


def _subject(tenant: str, pair: tuple[str, str]) -> str:
    return " ".join((tenant, *sorted(pair)))
