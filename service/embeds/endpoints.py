"""POST /v1/embed: mark a model."""

from __future__ import annotations

import asyncio
import secrets
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Header, Request, Response
from pydantic import BaseModel, ConfigDict, Field, JsonValue, model_validator

from engine.watermark.keys import OwnerKey
from service.core import Service
from service.http.access import Core, Embedder
from service.http.answers import JobView, respond, submit
from service.http.budgets import spend
from service.http.failures import responses
from service.http.forms import WHOLE, form_schema, read_form
from service.jobs.port import Job, State
from service.problems import Problem
from service.trust.api_keys import Caller
from service.trust.owner_keys import list_keys, open_key, store
from service.uploads.taking import expect, take, whole

router = APIRouter(prefix="/v1", tags=["embed"])
Format = Literal["ply", "compressed.ply", "splat", "spz", "sog"]


_GIVEN: dict[str, JsonValue] = {"message": {"type": "string"}, "bits": {"type": "integer"}}


class EmbedRequest(BaseModel):
    """What to mark, under which key, and how."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"not": {"required": ["message", "bits"], "properties": _GIVEN}}
    )
    upload_id: str = Field(min_length=1, max_length=64, description="A complete upload: the model.")
    key_id: str | None = Field(
        None,
        min_length=1,
        max_length=64,
        description="Owner key of this tenant; left out: its only one, which the first embed makes.",
    )
    message: str | None = Field(
        None, pattern="^([0-9a-fA-F]{2}){2,32}$", description="16 to 256 bits; drawn from the key if left out."
    )
    bits: Annotated[int, Field(ge=16, le=256, multiple_of=8), WHOLE] | None = Field(
        None, description="Length of a drawn message (32)."
    )
    profile: Literal["fast", "balanced", "strong", "auto"] = Field(
        "balanced", description="Speed against accuracy; auto: no more than the scene needs."
    )
    psnr: float | None = Field(None, ge=20, le=90, description="Least PSNR of the mark, dB (47).")
    budget: float | None = Field(None, ge=15, le=80, description="Prune to this PSNR, dB; left out: keep all.")
    output: Literal["fidelity", "compact"] = Field("fidelity", description="Keep each Gaussian's residual, or drop it.")
    format: Format | None = Field(None, description="Of the marked model; that of the upload if left out.")
    copy_name: str = Field("", max_length=100, description="Recipient: each copy has a mark of its own.")
    label: str = Field("", max_length=200, description="For people.")
    cameras_upload_id: str | None = Field(
        None,
        min_length=1,
        max_length=64,
        description="cameras.json or transforms.json; views are generated if left out.",
    )
    spz_frame: Literal["auto", "spec", "ply"] = Field("auto", description="Axes of an .spz that does not say.")

    @model_validator(mode="after")
    def _one_length(self) -> EmbedRequest:
        if self.message is not None and self.bits is not None:
            raise ValueError("give message or bits, not both: a message has a length of its own")
        return self


FILES = {"model": ("The model.", False), "cameras": ("cameras.json or transforms.json.", False)}
BODY = form_schema(EmbedRequest, FILES, ("upload_id", "cameras_upload_id"), ("model",))


@router.post(
    "/embed",
    status_code=202,
    operation_id="embed",
    openapi_extra=BODY,
    response_model=JobView,
    responses={
        200: {"model": JobView, "description": "Ended within the time of `Prefer: wait=N`"},
        **responses(
            "malformed-request",
            "unauthorized",
            "forbidden",
            "not-found",
            "conflict",
            "too-large",
            "unsupported-media-type",
            "invalid-request",
            "budget-exceeded",
        ),
    },
)
async def embed(
    request: Request,
    core: Core,
    caller: Embedder,
    prefer: Annotated[str | None, Header(description="wait=N: answer 200 if it ends within N seconds.")] = None,
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=128)] = None,
) -> Response:
    """Mark a model under an owner key. The job's result names the asset, from which model and record are fetched."""
    files: dict[str, Any]
    body, files = await read_form(request, EmbedForm, tuple(FILES))
    job = await asyncio.to_thread(_submit, core, caller, body, files, idempotency_key)
    return await respond(core, job, prefer)


class EmbedForm(EmbedRequest):
    """As a form brings it: the file may stand for the upload."""

    upload_id: str = Field("", max_length=64)


def _submit(core: Service, caller: Caller, body: EmbedForm, files: dict[str, Any], retry_key: str | None) -> Job:
    tenant = caller.tenant
    values = body.model_dump()
    for field, name in (("upload_id", "model"), ("cameras_upload_id", "cameras")):
        given = files.get(name, [])
        if len(given) > 1 or (given and values[field]):
            raise Problem("invalid-request", f"give one {name}, as a file or as an upload")
        if given:
            values[field] = take(core, tenant, given[0]).id
    if not values["upload_id"]:
        raise Problem("invalid-request", "body.upload_id: a model is needed, as an upload or as the file 'model'")
    model = whole(core, tenant, values["upload_id"])
    cameras = whole(core, tenant, values["cameras_upload_id"]) if values["cameras_upload_id"] else None
    expect([model], "model")
    expect([cameras] if cameras else [], "cameras")
    digests = {"model": model.sha256, "cameras": cameras.sha256 if cameras else None}
    unnamed = {name: value for name, value in values.items() if not name.endswith("upload_id")}

    def make() -> Job:
        key_id = values["key_id"] or _usual_key(core, tenant)
        open_key(core.db, core.master, tenant, key_id)  # or there is no such key
        spend(core.db, f"embed:{caller.key_id}", core.settings.embeds_per_hour, 1, "embed jobs of this API key")
        asked = {**unnamed, **digests, "key_id": key_id}
        return Job(f"job_{secrets.token_hex(12)}", tenant, caller.key_id, "embed", State.QUEUED, asked)

    return submit(core, tenant, retry_key, {"embed": unnamed, **digests}, make)


def _usual_key(core: Service, tenant: str) -> str:
    """The tenant's only key; made if there is none yet."""
    keys = list_keys(core.db, tenant)
    if len(keys) > 1:
        raise Problem("invalid-request", "body.key_id: this tenant has several owner keys: name one")
    if not keys:
        return store(core.db, core.master, tenant, OwnerKey.generate(), "made by the first embed").id
    return keys[0].id
