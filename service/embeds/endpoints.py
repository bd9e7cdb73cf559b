"""POST /v1/embed: mark a model; /v1/notices: uploads of other accounts in which a mark of this tenant was found."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Annotated, Literal

import sqlalchemy as sa
from fastapi import APIRouter, Query, Request, Response
from pydantic import ConfigDict, Field, JsonValue, model_validator

from engine.watermark.keys import OwnerKey
from service.core import Service
from service.db import page, schema
from service.http.access import NO_ZERO, After, Core, Embedder, Limit, Listed, Reader
from service.http.budgets import spend
from service.http.error_responses import OF_LIST
from service.http.forms import WHOLE, Files, RequestBody, form_schema, read_form
from service.http.job_responses import JOB_RESPONSES, JobView, Prefer, RetryKey, respond, submit
from service.http.results import Notice, notice_of
from service.jobs.port import Job
from service.problems import Problem
from service.trust.api_keys import Caller
from service.trust.owner_keys import list_keys, open_key, store
from service.uploads.ingest import gather
from service.uploads.store import check_quota

router = APIRouter(prefix="/v1", tags=["embed"])
notices = APIRouter(prefix="/v1/notices", tags=["notices"])
Format = Literal["ply", "compressed.ply", "splat", "spz", "sog", "glb"]


_GIVEN: dict[str, JsonValue] = {"message": {"type": "string"}, "bits": {"type": "integer"}}
_EXAMPLE: JsonValue = {"upload_id": "up_d40313a36c48f4baf73fb30a", "copy_name": "acme", "profile": "fast"}


class EmbedRequest(RequestBody):
    """What to mark, under which key, and how."""

    model_config = ConfigDict(
        json_schema_extra={"not": {"required": ["message", "bits"], "properties": _GIVEN}, "examples": [_EXAMPLE]}
    )
    upload_id: str = Field(min_length=1, max_length=64, description="A complete upload: the model.")
    key_id: str | None = Field(
        None,
        min_length=1,
        max_length=64,
        description="Owner key of this tenant; left out: its only one, made by the first embed.",
    )
    message: str | None = Field(
        None, pattern="^([0-9a-fA-F]{2}){2,32}$", description="16 to 256 bits; drawn from the key if left out."
    )
    bits: Annotated[int, Field(ge=16, le=256, multiple_of=8), WHOLE] | None = Field(
        None, description="Length of a drawn message (32)."
    )
    profile: Literal["fast", "balanced", "strong", "auto", "paper", "paper-appendix"] = Field(
        "auto",
        description="auto: no more than the scene needs; fast to strong: more evidence, more time; paper: as printed.",
    )
    survive: Literal["model", "pictures", "worst"] | None = Field(
        None, description="auto: what must show the mark: one JPEG-10 picture (default), the worst one, models alone."
    )
    psnr: float | None = Field(
        None,
        ge=20,
        le=90,
        description="Least PSNR of the mark, dB (47; auto: down to 45); above the profile's: scope `originals`.",
    )
    budget: float | None = Field(None, ge=15, le=80, description="Prune to this PSNR, dB; left out: keep all.")
    output: Literal["fidelity", "compact"] | None = Field(
        None, description="Keep each Gaussian's residual, or drop it; profile default if left out."
    )
    format: Format | None = Field(None, description="Format of the marked model; the upload's if left out.")
    copy_name: str = Field("", max_length=100, description="Recipient: each copy has a mark of its own.")
    label: str = Field("", max_length=200, description="For display; the file's name if left out.")
    cameras_upload_id: str | None = Field(
        None,
        min_length=1,
        max_length=64,
        description="cameras.json or transforms.json; views are generated if left out.",
    )
    spz_frame: Literal["auto", "spec", "ply"] = Field("auto", description="Axes of an .spz that states none.")

    @model_validator(mode="after")
    def _one_length(self) -> EmbedRequest:
        if self.message is not None and self.bits is not None:
            raise ValueError("provide message or bits, not both: a message has its own length")
        if self.survive is not None and self.profile != "auto":
            raise ValueError("survive is for profile 'auto': the others choose nothing")
        return self


FILES = {"model": ("The model.", False), "cameras": ("cameras.json or transforms.json.", False)}
BODY = form_schema(EmbedRequest, FILES, ("upload_id", "cameras_upload_id"), ("model",))


@router.post(
    "/embed", status_code=202, operation_id="embed", openapi_extra=BODY, response_model=JobView, responses=JOB_RESPONSES
)
async def embed(
    request: Request, core: Core, caller: Embedder, prefer: Prefer = None, idempotency_key: RetryKey = None
) -> Response:
    """Mark a model under an owner key. The job's result names the asset, from which model and record are fetched."""
    body, files = await read_form(request, EmbedForm, tuple(FILES))
    job = await asyncio.to_thread(_submit, core, caller, body, files, idempotency_key)
    return await respond(core, job, prefer)


class EmbedForm(EmbedRequest):
    """As a form brings it: the file may stand for the upload."""

    upload_id: str = Field("", max_length=64)


def _submit(core: Service, caller: Caller, body: EmbedForm, files: Files, retry_key: str | None) -> Job:
    _check_fidelity(caller, body)
    tenant, digests, names = caller.tenant, {}, {}
    for name, upload_id in (("model", body.upload_id), ("cameras", body.cameras_upload_id)):
        named, brought = [upload_id] if upload_id else [], files.get(name, [])
        if len(named) + len(brought) > 1:
            raise Problem("invalid-request", f"provide one {name}, as a file or as an upload")
        rows = gather(core, caller, named, brought, name)
        digests[name] = rows[0].sha256 if rows else None
        names[name] = [row.name for row in rows]
    if digests["model"] is None:
        raise Problem("invalid-request", "body.upload_id: a model is needed, as an upload or as the file 'model'")
    unnamed = body.model_dump(exclude={"upload_id", "cameras_upload_id"})

    def make() -> Mapping[str, object]:
        key_id = body.key_id or _usual_key(core, tenant)
        open_key(core.db, core.master, tenant, key_id)  # or there is no such key
        with core.db.read() as connection:
            check_quota(connection, core.settings, tenant, 0)
        spend(core.db, f"embed:{caller.key_id}", core.settings.embeds_per_hour, 1, "embed jobs of this API key")
        return {**unnamed, **digests, "key_id": key_id, "names": names["model"]}

    return submit(core, caller, "embed", retry_key, {"embed": unnamed, **digests}, make)


def _check_fidelity(caller: Caller, body: EmbedForm) -> None:
    """forbidden where the mark were so faint that the marked model is as good as the unmarked one."""
    if body.psnr is None or caller.may("originals"):
        return
    from engine.flows.embed.profiles import AUTO, PROFILES, Auto

    usual = (Auto().start if body.profile == AUTO else PROFILES[body.profile]).psnr_db
    if body.psnr > usual:
        text = f"psnr {body.psnr:g}: more than the {usual:g} dB of profile {body.profile!r} needs the scope 'originals'"
        raise Problem("forbidden", text)


def _usual_key(core: Service, tenant: str) -> str:
    """The tenant's only key; made if there is none yet."""
    keys = list_keys(core.db, tenant)
    if len(keys) > 1:
        raise Problem("invalid-request", "body.key_id: this tenant has several owner keys: name one")
    (key,) = keys or [store(core.db, core.master, tenant, OwnerKey.generate(), "made by the first embed")]
    return str(key.id)


class NoticeList(Listed[Notice]):
    """A page of notices, newest first."""


@notices.get("", operation_id="listNotices", responses=OF_LIST)
def list_notices(
    core: Core,
    caller: Reader,
    limit: Limit = 20,
    after: After = "",
    asset: Annotated[str, Query(max_length=64, pattern=NO_ZERO, description="About the asset of this id.")] = "",
) -> NoticeList:
    """Uploads of other accounts that carry a mark of yours, newest first. The uploader is neither notified nor named;
    the operator of the service can start a dispute between the two assets."""
    where = schema.notices.c.asset == asset if asset else sa.true()
    with core.db.read() as connection:
        rows, following = page(connection, schema.notices, caller.tenant, limit, after, where=where)
    return NoticeList(items=[notice_of(row) for row in rows], next=following)
