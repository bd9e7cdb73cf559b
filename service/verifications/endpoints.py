"""POST /v1/verify: does this suspect carry a mark of ours?"""

import asyncio
from collections.abc import Mapping, Sequence
from datetime import date
from typing import Annotated, Literal

from fastapi import APIRouter, Request, Response
from pydantic import BeforeValidator, ConfigDict, Field, JsonValue

from engine.watermark.statistics import CHANCE_RATE
from service.core import Service
from service.db import own
from service.db.schema import acquisitions
from service.http.access import Core, Verifier
from service.http.budgets import spend
from service.http.forms import Files, RequestBody, form_schema, read_form
from service.http.job_responses import JOB_RESPONSES, JobView, Prefer, RetryKey, respond, submit
from service.jobs.port import Job
from service.problems import Problem
from service.trust.api_keys import Caller
from service.uploads.ingest import gather
from service.verifications.flow import count_asset

router = APIRouter(prefix="/v1", tags=["verify"])
MOST_RATE = 1e-6
"""No claim is signed above it, for any caller."""
_DAY = BeforeValidator(lambda text: date.fromisoformat(text) if isinstance(text, str) else text)
Id = Annotated[str, Field(min_length=1, max_length=64)]


_EXAMPLES: JsonValue = [
    {"upload_id": "up_f6b2ce7c59a1e745e1b7d86e", "suspect_seen": "2026-11-21"},
    {"image_upload_ids": ["up_0c9f0f3f7fd1b4b3c8b41a42"], "asset_id": "as_d40313a36c48f4baf73fb30a"},
]


class VerifyRequest(RequestBody):
    """What to check, and against what."""

    model_config = ConfigDict(json_schema_extra={"examples": _EXAMPLES})
    upload_id: str | None = Field(
        None, min_length=1, max_length=64, description="A complete upload: the suspect model."
    )
    image_upload_ids: list[Id] = Field(
        [], max_length=64, description="Complete uploads: pictures of one suspect, read together."
    )
    cameras_upload_id: str | None = Field(
        None, max_length=64, description="Cameras of the pictures, in their order; found by search if left out."
    )
    asset_id: str | None = Field(
        None, max_length=64, description="Asset to check against; left out: all of this tenant, likely ones first."
    )
    false_claim_rate: float = Field(
        CHANCE_RATE,
        gt=0,
        le=MOST_RATE,
        description="Largest acceptable chance of a false claim; counts only where it is stricter than what applies:"
        " 1e-9 where a time-stamping service drew a part of the mark, else 2^-128.",
    )
    suspect_seen: Annotated[date, Field(description="Since when the suspect is known."), _DAY] | None = None
    acquisition_id: str | None = Field(
        None, max_length=64, description="Acquisition of this very suspect (the same bytes); the claim then names it."
    )
    route: Literal["auto", "model", "render", "image"] = Field("auto", description="Kind of evidence.")
    spz_frame: Literal["auto", "spec", "ply"] = Field("auto", description="Axes of an .spz that states none.")


FILES = {
    "model": ("The suspect model.", False),
    "images": ("1 to 64 pictures.", True),
    "cameras": ("Cameras of the pictures, in their order.", False),
}
WAYS = {"VerifyModelRequest": ("upload_id",), "VerifyPicturesRequest": ("image_upload_ids", "cameras_upload_id")}
BODY = form_schema(VerifyRequest, FILES, ("upload_id", "image_upload_ids", "cameras_upload_id"), ways=WAYS)


@router.post(
    "/verify",
    status_code=202,
    operation_id="verify",
    openapi_extra=BODY,
    response_model=JobView,
    responses=JOB_RESPONSES,
)
async def verify(
    request: Request, core: Core, caller: Verifier, prefer: Prefer = None, idempotency_key: RetryKey = None
) -> Response:
    """Check a suspect model, or pictures of one. The job's result names the claim; a negative answer is a claim too."""
    body, files = await read_form(request, VerifyRequest, tuple(FILES))
    job = await asyncio.to_thread(_submit, core, caller, body, files, idempotency_key)
    return await respond(core, job, prefer)


def _submit(core: Service, caller: Caller, body: VerifyRequest, files: Files, retry_key: str | None) -> Job:
    model_files, image_files, camera_files = (files.get(name, []) for name in FILES)
    models = [body.upload_id] if body.upload_id else []
    cameras = [body.cameras_upload_id] if body.cameras_upload_id else []
    if bool(models or model_files) == bool(body.image_upload_ids or image_files):
        raise Problem("invalid-request", "provide one suspect: a model, or pictures of one")
    if len(models) + len(model_files) > 1 or len(cameras) + len(camera_files) > 1:
        raise Problem("invalid-request", "provide exactly one model, and cameras at most once")
    if len(body.image_upload_ids) + len(image_files) > 64:
        raise Problem("invalid-request", "at most 64 pictures are read together")
    if (cameras or camera_files) and (models or model_files):
        raise Problem("invalid-request", "cameras are only allowed with pictures")
    model = gather(core, caller, models, model_files, "model")
    images = gather(core, caller, body.image_upload_ids, image_files, "picture")
    views = gather(core, caller, cameras, camera_files, "cameras")
    request: dict[str, object] = {
        "model": model[0].sha256 if model else None,
        "images": [row.sha256 for row in images],
        "cameras": views[0].sha256 if views else None,
        **body.model_dump(include={"asset_id", "false_claim_rate", "route", "spz_frame", "suspect_seen"}, mode="json"),
    }

    request |= _acquired(core, caller, body, [row.sha256 for row in (*model, *images)])

    def make() -> Mapping[str, object]:
        spend(core.db, f"verify:{caller.key_id}", core.settings.verifies_per_hour, 1, "verify jobs of this API key")
        if body.asset_id is not None:
            count_asset(core, caller.tenant, body.asset_id)
        return {**request, "names": [row.name for row in (*model, *images)]}  # not part of what a retry is known by

    return submit(core, caller, "verify", retry_key, {"verify": request}, make)


def _acquired(core: Service, caller: Caller, body: VerifyRequest, suspect: Sequence[str]) -> Mapping[str, str]:
    """What a request says of a suspect of these digests that was acquired; conflict where something else was."""
    if body.acquisition_id is None:
        return {}
    row = own(core.db, acquisitions, caller.tenant, body.acquisition_id)
    if row.payload_sha256 not in suspect:
        text = f"acquisition {row.id!r} has SHA-256 {row.payload_sha256}, the suspect {', '.join(suspect)}"
        raise Problem("conflict", text)
    if body.suspect_seen is not None and body.suspect_seen.isoformat() > row.at:
        text = f"suspect_seen: the suspect was acquired on {row.at}, before {body.suspect_seen}"
        raise Problem("invalid-request", text)
    return {"acquisition_id": row.id, "suspect_existed": row.at}
