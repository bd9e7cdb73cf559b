"""/v1/acquisitions: suspects, preserved as found, before they are examined."""

import asyncio
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, JsonValue, model_validator

from service.acquisitions import registry
from service.acquisitions.archive import MEDIA_TYPE
from service.acquisitions.fetching import fetch
from service.claims.schema import Url
from service.core import Service
from service.db import missing, own
from service.db.schema import acquisitions
from service.http import idempotency
from service.http.access import Admin, After, Core, Limit, Listed, Reader, Verifier, may
from service.http.budgets import spend
from service.http.error_responses import OF_LIST, OF_OWN, responses
from service.http.file_responses import Want, file_responses, send_blob
from service.http.forms import RequestBody
from service.http.job_responses import RetryKey
from service.http.results import Time
from service.trust.api_keys import Caller
from service.trust.commitments import forget
from service.uploads import store

router = APIRouter(prefix="/v1/acquisitions", tags=["acquisitions"])
Viewer = Annotated[Caller, Depends(may("read", "verify"))]
"""Sees acquisitions: without `read`, those of this very key."""
_EXAMPLES: JsonValue = [{"url": "https://models.example/stolen.ply"}, {"upload_id": "up_f6b2ce7c59a1e745e1b7d86e"}]


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
    timestamp: Annotated[str | None, BeforeValidator(registry.encoded)] = Field(
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
        return await asyncio.to_thread(registry.keep_upload, core, caller, body.upload_id or "")
    url, limits = str(body.url), core.settings
    most = min(limits.max_upload_bytes, await asyncio.to_thread(store.left, core, caller.tenant))
    with core.blobs.new_file() as file:
        exchanges, got = await fetch(url, file, most, limits.acquire_seconds, private=limits.acquisitions_private)
        return await asyncio.to_thread(registry.keep_fetched, core, caller, url, file, got, exchanges)


@router.get("", operation_id="listAcquisitions", responses=OF_LIST)
def list_acquisitions(core: Core, caller: Reader, limit: Limit = 20, after: After = "") -> AcquisitionList:
    """Acquisitions of this tenant, newest first."""
    return AcquisitionList.of(core, acquisitions, caller.tenant, limit, after)


@router.get("/{acquisition_id}", operation_id="getAcquisition", responses=OF_OWN)
def get_acquisition(acquisition_id: str, core: Core, caller: Viewer) -> Acquisition:
    """An acquisition."""
    return Acquisition.model_validate(_seen(core, caller, acquisition_id))


@router.get(
    "/{acquisition_id}/warc",
    operation_id="getAcquisitionWarc",
    response_class=Response,
    responses=file_responses(MEDIA_TYPE),
)
def get_warc(acquisition_id: str, core: Core, caller: Viewer, want: Want) -> Response:
    """The WARC file (ISO 28500, gzip): what was sent and answered, byte for byte."""
    row = _seen(core, caller, acquisition_id)
    return send_blob(core, row.warc_sha256, f"{row.id}.warc.gz", MEDIA_TYPE, want)


@router.delete("/{acquisition_id}", status_code=204, operation_id="deleteAcquisition", responses=OF_OWN)
def delete_acquisition(acquisition_id: str, core: Core, caller: Admin) -> None:
    """Delete an acquisition and its file here; the log and claims that name it keep its digests."""
    forget(core.db, acquisitions, caller.tenant, acquisition_id)


def _seen(core: Service, caller: Caller, acquisition_id: str) -> Any:
    row = own(core.db, acquisitions, caller.tenant, acquisition_id)
    if not caller.may("read") and row.api_key != caller.key_id:
        raise missing(acquisitions, acquisition_id)
    return row
