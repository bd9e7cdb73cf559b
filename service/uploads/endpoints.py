"""/v1/uploads: slots, and their bytes."""

import asyncio
from typing import Annotated, Literal

from fastapi import APIRouter, Header, Request, Response
from pydantic import BaseModel, ConfigDict, Field, JsonValue

from service.db.schema import uploads
from service.http.access import After, Core, Limit, Listed, Uploader
from service.http.error_responses import OF_LIST, OF_OWN, responses
from service.http.file_responses import BINARY
from service.http.forms import FROM_JSON, WHOLE, RequestBody
from service.http.results import FileInfo, Time
from service.problems import Problem
from service.uploads import store
from service.uploads.ingest import take

router = APIRouter(prefix="/v1/uploads", tags=["uploads"])
OCTETS = {"requestBody": {"required": True, "content": {"application/octet-stream": BINARY}}}


_EXAMPLE: JsonValue = {"name": "plant.ply", "size": 28185736}


class NewUpload(RequestBody):
    """A slot for one file."""

    model_config = ConfigDict(strict=True, json_schema_extra={"examples": [_EXAMPLE]})
    name: str = Field("", max_length=200, description="File name, for display; never used as a path.")
    size: Annotated[int, Field(ge=1, le=1 << 50), WHOLE] | None = Field(
        None, description="Size, bytes; needed to resume."
    )
    sha256: str | None = Field(None, pattern="^[0-9a-f]{64}$", description="Expected digest of the bytes.")


class Upload(BaseModel):
    """An upload and its state."""

    model_config = ConfigDict(from_attributes=True)
    id: str
    name: str
    size: int | None
    offset: int = Field(validation_alias="received", description="Bytes received: the next request continues here.")
    state: Literal["open", "complete"]
    sha256: str | None
    info: Annotated[FileInfo | None, FROM_JSON] = Field(description="What the file is, once it was inspected.")
    created_at: Time


class UploadList(Listed[Upload]):
    """A page of uploads, newest first."""


@router.post(
    "",
    status_code=201,
    operation_id="createUpload",
    responses=responses(
        *("malformed-request", "unauthorized", "forbidden", "too-large", "invalid-request", "budget-exceeded")
    ),
)
def create_upload(body: NewUpload, core: Core, caller: Uploader, response: Response) -> Upload:
    """Open a slot; send the bytes with PUT."""
    row = store.create(core, caller, body.name, body.size, body.sha256)
    response.headers["Location"] = f"/v1/uploads/{row.id}"
    return Upload.model_validate(row)


@router.get("", operation_id="listUploads", responses=OF_LIST)
def list_uploads(core: Core, caller: Uploader, limit: Limit = 20, after: After = "") -> UploadList:
    """Uploads of this API key (for `admin`: of the tenant) that are still here, newest first."""
    return UploadList.of(core, uploads, caller.tenant, limit, after, where=store.of(caller))


@router.get("/{upload_id}", operation_id="getUpload", responses=OF_OWN)
def get_upload(upload_id: str, core: Core, caller: Uploader) -> Upload:
    """State of an upload: `offset` says where to continue."""
    return Upload.model_validate(store.get(core, caller, upload_id))


@router.put(
    "/{upload_id}",
    operation_id="putUpload",
    openapi_extra=OCTETS,
    responses=responses(
        "unauthorized", "forbidden", "not-found", "conflict", "too-large", "invalid-request", "malformed-request"
    ),
)
async def put_upload(
    upload_id: str,
    request: Request,
    core: Core,
    caller: Uploader,
    upload_offset: Annotated[int, Header(ge=0, description="Where these bytes begin.")] = 0,
) -> Upload:
    """Send bytes, streamed to disk. After a broken connection, ask for `offset` and continue there.

    Of requests that begin at one offset, one is accepted; the others answer 409 with the `offset` to continue at, and
    change nothing.
    The upload is complete when `size` bytes have come, or, where no size was announced, with the end of the request.
    A model that cannot be read is refused then.
    """
    row = await asyncio.to_thread(store.get, core, caller, upload_id)
    if row.state != "open":
        raise Problem("conflict", f"upload {upload_id!r} is complete", offset=row.received)
    if upload_offset != row.received:
        text = f"bytes from {upload_offset} on were sent, {row.received} are here"
        raise Problem("conflict", text, offset=row.received)
    return Upload.model_validate(await take(core, row, request.stream()))


@router.delete("/{upload_id}", status_code=204, operation_id="deleteUpload", responses=OF_OWN)
def delete_upload(upload_id: str, core: Core, caller: Uploader) -> None:
    """Delete an upload; what was made from it stays."""
    store.drop(core, store.get(core, caller, upload_id))
