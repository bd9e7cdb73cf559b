"""/v1/acquisitions: suspects, preserved as found, before they are examined."""

import asyncio
import base64
import secrets
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import httpx
from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, JsonValue, model_validator

from engine.records.timestamps import stamp
from service.acquisitions.archive import MEDIA_TYPE, write_warc
from service.acquisitions.fetching import Exchange, fetch
from service.claims.schema import Url
from service.clock import now
from service.core import Service
from service.db import own
from service.db.schema import acquisitions
from service.http import idempotency
from service.http.access import Admin, After, Core, Limit, Listed, Reader, Verifier, may, visible
from service.http.budgets import spend
from service.http.error_responses import OF_LIST, OF_OWN, responses
from service.http.file_responses import Want, file_responses, send_blob
from service.http.forms import RequestBody
from service.http.job_responses import RetryKey
from service.http.results import Time
from service.problems import Problem
from service.processes import task_folder
from service.trust import audit
from service.trust.api_keys import Caller
from service.trust.canonical import canonical, digest
from service.trust.commitments import ACQUISITION_MADE, acquisition_facts, forget
from service.uploads import ingest, store
from service.uploads.store import Received

router = APIRouter(prefix="/v1/acquisitions", tags=["acquisitions"])
Viewer = Annotated[Caller, Depends(may("read", "verify"))]
"""Sees acquisitions: without `read`, those of this very key."""
_EXAMPLES: JsonValue = [{"url": "https://models.example/stolen.ply"}, {"upload_id": "up_f6b2ce7c59a1e745e1b7d86e"}]


def _encoded(token: bytes | None) -> str | None:
    return None if token is None else base64.b64encode(token).decode()


class NewAcquisition(RequestBody):
    """What to acquire: provide exactly one of `url` and `upload_id`."""

    model_config = ConfigDict(json_schema_extra={"examples": _EXAMPLES})
    url: Url | None = Field(None, description="Address on the open network, http or https; redirects are followed.")
    upload_id: str | None = Field(
        None, min_length=1, max_length=64, description="A complete upload: a file that you saved yourself."
    )

    @model_validator(mode="after")
    def _one(self) -> "NewAcquisition":
        if (self.url is None) == (self.upload_id is None):
            raise ValueError("provide exactly one of url and upload_id")
        return self


class Acquisition(BaseModel):
    """An acquired file."""

    model_config = ConfigDict(from_attributes=True)
    id: str
    url: str | None = Field(description="Address that was fetched; null for an uploaded file.")
    at: Time
    bytes: int
    payload_sha256: str
    warc_sha256: str = Field(description="Of the file at `.../warc`.")
    upload_id: str | None = Field(
        validation_alias="upload", description="The suspect as an upload, to verify; null if it is no suspect."
    )
    timestamp: Annotated[str | None, BeforeValidator(_encoded)] = Field(
        description="RFC 3161 token of id, url, at, payload_sha256 and warc_sha256 as canonical JSON, base64; null"
        " where none was made."
    )


class MadeAcquisition(Acquisition):
    """An acquisition just made."""

    timestamp_failure: str = Field("", description="Why there is no time stamp; empty where there is one.")


class AcquisitionList(Listed[Acquisition]):
    """A page of acquisitions, newest first."""


@router.post(
    "",
    status_code=201,
    operation_id="acquire",
    responses=responses(
        *("malformed-request", "unauthorized", "forbidden", "not-found", "conflict", "too-large", "invalid-request"),
        *("budget-exceeded", "not-fetched"),
    ),
)
async def acquire(
    body: NewAcquisition, core: Core, caller: Verifier, response: Response, idempotency_key: RetryKey = None
) -> MadeAcquisition:
    """Fetch a suspect from its address, or take an upload, and preserve it unchanged: bytes, headers, certificates of
    the server and time in a WARC file (ISO 28500), logged and time-stamped.

    A verification of the same bytes may name it (`acquisition_id`). This service states what the address answered; a
    time stamp, where there is one, attests that the bytes existed by then. A request that is sent again with its
    Idempotency-Key is answered with what the first one made.
    """
    if idempotency_key is None:
        row, failure = await _acquired(core, caller, body)
    else:
        row, failure = await _acquired_once(core, caller, body, idempotency_key)
    response.headers["Location"] = f"/v1/acquisitions/{row.id}"
    return MadeAcquisition.model_validate(row._asdict() | {"timestamp_failure": failure})


async def _acquired_once(core: Service, caller: Caller, body: NewAcquisition, key: str) -> tuple[Any, str]:
    request = {"acquire": body.model_dump(mode="json")}
    hours = core.settings.acquire_seconds / 3600 + idempotency.IN_FLIGHT_HOURS  # the address may take all its time
    first = await asyncio.to_thread(idempotency.begin, core.db, caller, key, request, hours)
    if first is not None:
        row = await asyncio.to_thread(own, core.db, acquisitions, caller.tenant, first)
        return row, "" if row.timestamp is not None else "the first request with this Idempotency-Key got none"
    try:
        row, failure = await _acquired(core, caller, body)
    except BaseException:
        await asyncio.to_thread(idempotency.release, core.db, caller, key)
        raise
    await asyncio.to_thread(idempotency.settle, core.db, caller, key, row.id)
    return row, failure


async def _acquired(core: Service, caller: Caller, body: NewAcquisition) -> tuple[Any, str]:
    limit = core.settings.acquisitions_per_hour
    what = "acquisitions of this API key"
    await asyncio.to_thread(spend, core.db, f"acquire:{caller.key_id}", limit, 1, what)
    if body.url is None:
        return await asyncio.to_thread(_keep_upload, core, caller, body.upload_id or "")
    url, limits = str(body.url), core.settings
    most = min(limits.max_upload_bytes, await asyncio.to_thread(store.left, core, caller.tenant))
    with core.blobs.new_file() as file:
        exchanges, got = await fetch(url, file, most, limits.acquire_seconds, private=limits.acquisitions_private)
        return await asyncio.to_thread(_keep_fetched, core, caller, url, file, got, exchanges)


@router.get("", operation_id="listAcquisitions", responses=OF_LIST)
def list_acquisitions(core: Core, caller: Reader, limit: Limit = 20, after: After = "") -> AcquisitionList:
    """Acquisitions of this tenant, newest first."""
    return AcquisitionList.of(core, acquisitions, caller.tenant, limit, after)


@router.get("/{acquisition_id}", operation_id="getAcquisition", responses=OF_OWN)
def get_acquisition(acquisition_id: str, core: Core, caller: Viewer) -> Acquisition:
    """An acquisition."""
    return Acquisition.model_validate(visible(core, caller, acquisitions, acquisition_id))


@router.get(
    "/{acquisition_id}/warc",
    operation_id="getAcquisitionWarc",
    response_class=Response,
    responses=file_responses(MEDIA_TYPE),
)
def get_warc(acquisition_id: str, core: Core, caller: Viewer, want: Want) -> Response:
    """The WARC file (ISO 28500, gzip): what was sent and answered, byte for byte."""
    row = visible(core, caller, acquisitions, acquisition_id)
    return send_blob(core, row.warc_sha256, f"{row.id}.warc.gz", MEDIA_TYPE, want)


@router.delete("/{acquisition_id}", status_code=204, operation_id="deleteAcquisition", responses=OF_OWN)
def delete_acquisition(acquisition_id: str, core: Core, caller: Admin) -> None:
    """Delete an acquisition and its file here; the log and claims that name it keep its digests."""
    forget(core.db, acquisitions, caller.tenant, acquisition_id)


def _keep_fetched(
    service: Service, caller: Caller, url: str, body: Path, got: Received, exchanges: Sequence[Exchange]
) -> tuple[Any, str]:
    """The row of what was fetched, and why it has no time stamp, if it has none. A suspect becomes an upload, too."""
    with service.blobs.new_file() as warc:
        write_warc(warc, body, exchanges, "", exchanges[-1].at)
        name = PurePosixPath(httpx.URL(exchanges[-1].url).path).name[:200]
        row = store.create(service, caller, name, got.length or None, None)
        row = store.complete(service, row, body, got)
        upload: str | None = row.id
        try:
            ingest.inspect(service, [row])
        except Problem as problem:
            if problem.status >= 500:
                raise
            upload = None  # a page, say: it is evidence all the same
        return _keep(service, caller, warc, url=url, at=exchanges[-1].at, got=got, upload=upload)


def _keep_upload(service: Service, caller: Caller, upload_id: str) -> tuple[Any, str]:
    """As `_keep_fetched`, of a file that the caller uploaded."""
    row = ingest.complete_upload(service, caller, upload_id)
    at = now()
    with service.blobs.new_file() as warc, task_folder(service.settings) as folder:
        write_warc(warc, service.blobs.local(row.sha256, folder), [], row.name, at)
        got = Received(row.size, row.sha256, whole=True)
        return _keep(service, caller, warc, url=None, at=at, got=got, upload=row.id)


def _keep(
    service: Service, caller: Caller, warc: Path, *, url: str | None, at: str, got: Received, upload: str | None
) -> tuple[Any, str]:
    size = warc.stat().st_size
    acquisition = f"aq_{secrets.token_hex(12)}"
    values: dict[str, str | None] = {"id": acquisition, "url": url, "at": at}
    values |= {"payload_sha256": got.sha256, "warc_sha256": service.blobs.put(warc)}
    facts = acquisition_facts(values)
    token, failure = None, "this service uses no time-stamping service"
    if service.settings.tsa_url:
        stamped = stamp(service.settings.tsa_url, canonical(facts))
        token, failure = stamped.token, stamped.failure
    values |= {"tenant": caller.tenant, "api_key": caller.key_id, "created_at": now(), "upload": upload}
    with service.db.exclusive() as connection:
        store.check_quota(connection, service.settings, caller.tenant, size)
        row = values | {"bytes": got.length, "warc_bytes": size, "timestamp": token}
        connection.execute(acquisitions.insert().values(row))
        audit.append(connection, caller.tenant, ACQUISITION_MADE, {"digest": digest(facts)}, acquisition)
    return own(service.db, acquisitions, caller.tenant, acquisition), failure
