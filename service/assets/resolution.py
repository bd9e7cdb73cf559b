"""The query and fetch routes of C2PA's Soft Binding Resolution API 2.4, under /v1: a mark leads to its manifest.

Open to all, as manifests are: a caller who names a record's id (128 bits, in the file, in its claims and nowhere to be
guessed) gets what the owner let out with the file, and nothing else. Only a search by content takes an API key, since
it takes a body and processor time.

A search finds manifests of models and pictures that lost theirs. No owner key, record or mark is used: the index
compares with sketches of published models, which can be computed from such a model alone; only assets whose owner set
`by_content` are searched.
"""

import asyncio
import json
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field

from engine.credentials.manifest import ALG, MEDIA_TYPE, bound_record
from service.asset_screening import scores
from service.assets.conversions import once
from service.core import Service
from service.db import missing
from service.db.schema import assets, manifests, published
from service.http.access import Anyone, Core
from service.http.budgets import spend, spend_subject
from service.http.error_responses import responses
from service.http.file_responses import BINARY, one_file
from service.jobs.port import Job, Run, State
from service.problems import Problem
from service.processes import Reply, run_within, task_folder
from service.trust.api_keys import Caller
from service.uploads.ingest import receive
from service.uploads.store import kind_of

SEARCH_SECONDS, INDEX_SECONDS = 60.0, 600.0
"""An index that lacks many assets is made first, which a search that gave up will find made."""


async def find_alike(service: Service, caller: Caller, path: Path) -> list[tuple[str, int]]:
    """Ids of manifests, each with its score (50 or 100), the highest first; of equal ones those of the asset that was
    registered first, which later lookalikes cannot displace; of one asset the newest first.

    unreadable-model or unreadable-image where it is neither; unsupported-media-type for cameras; budget-exceeded where
    too many of the tenant's questions are being answered, or were asked today about things like one asset.
    """
    joined = manifests.join(assets, manifests.c.asset == assets.c.id).join(published, published.c.asset == assets.c.id)
    query = sa.select(manifests.c.id, assets.c.original_sha256).select_from(joined).where(published.c.by_content)
    query = query.order_by(assets.c.registered_at, assets.c.id, manifests.c.created_at.desc(), manifests.c.id)
    rows = await asyncio.to_thread(lambda: service.db.query(query).all())
    this = (secrets.token_hex(16), "by content")  # a question of its own: two askers of one share no file
    found = json.loads(await once(service, caller.tenant, this, lambda: _search(service, caller, path, rows)))
    if found:
        clearest, what = max(found, key=found.__getitem__), "questions about what derives from one original"
        await asyncio.to_thread(spend_subject, service, caller.tenant, clearest, what)
    hits = [(row.id, int(found[row.original_sha256])) for row in rows if row.original_sha256 in found]
    return sorted(hits, key=lambda hit: -hit[1])


def _search(service: Service, caller: Caller, path: Path, rows: Any) -> str:
    """Scores by original, as JSON."""
    kind = kind_of(path, "")
    if kind == "cameras":
        raise Problem("unsupported-media-type", "the body is neither a model nor a picture")
    suspect = {"model": None, "images": [str(path)]} if kind == "picture" else {"model": str(path)}
    with task_folder(service.settings) as folder:

        def work(task: str, request: Mapping[str, Any]) -> Reply:
            seconds = INDEX_SECONDS if task == "index" else SEARCH_SECONDS
            return run_within(service.settings, task, request, folder, seconds, caller.tenant, "the search")

        run = Run(Job("", caller.tenant, caller.key_id, "match", State.RUNNING, {}), folder=folder, work=work)
        return json.dumps(scores(service, run, suspect, rows))


router = APIRouter(prefix="/v1", tags=["credentials"])
Most = Annotated[int, Query(alias="maxResults", ge=1, le=100, description="Ids to return at most.")]
_MEDIA = ("application", "image", "model")
_CONTENT = {"requestBody": {"required": True, "content": {f"{kind}/*": BINARY for kind in _MEDIA}}}


class Match(BaseModel):
    """A manifest that a soft binding leads to."""

    manifestId: str = Field(examples=["urn:c2pa:3fad1ead-8ed5-44d0-873b-ea5f58adea82"])


class Matches(BaseModel):
    """Manifests of one mark, the latest first."""

    matches: list[Match]


class AlikeMatch(Match):
    """A manifest of an asset that the content is like."""

    similarityScore: int = Field(
        ge=50, le=100, description="100: clearly alike; 50: close to the limit below which strangers stay."
    )


class AlikeMatches(BaseModel):
    """Manifests of assets that the content is like, the likeliest first."""

    matches: list[AlikeMatch]


class Algorithm(BaseModel):
    """A soft binding's algorithm."""

    alg: str = Field(examples=[ALG])


class Algorithms(BaseModel):
    """Supported algorithms."""

    watermarks: list[Algorithm]


@router.get("/matches/byBinding", operation_id="queryByBinding", responses=responses("invalid-request"))
def query_by_binding(
    core: Core,
    alg: Annotated[str, Query(description="Name of the soft binding's algorithm.", max_length=200)],
    value: Annotated[str, Query(description="As the manifest names it: 16 bytes in base64.", max_length=200)],
    most: Most = 10,
) -> Matches:
    """Ids of the manifests that name this mark; none where it, or the algorithm, is unknown."""
    record = bound_record(value) if alg == ALG else ""
    joined = manifests.join(assets, manifests.c.asset == assets.c.id)
    query = sa.select(manifests.c.id).select_from(joined).where(manifests.c.binding == record)
    found = core.db.query(query.order_by(manifests.c.created_at.desc()).limit(most)).scalars().all()
    return Matches(matches=[Match(manifestId=each) for each in found])


@router.post(
    "/matches/byContent",
    operation_id="queryByContent",
    openapi_extra=_CONTENT,
    responses=responses(
        *("malformed-request", "unauthorized", "forbidden", "too-large", "unsupported-media-type"),
        *("unreadable-model", "budget-exceeded"),
    ),
)
async def query_by_content(
    request: Request,
    core: Core,
    caller: Anyone,
    alg: Annotated[str, Query(description="Only manifests with this algorithm's soft binding.", max_length=200)] = ALG,
    most: Most = 10,
) -> AlikeMatches:
    """Ids of the manifests of assets that a model or picture is like, also cropped, converted or re-encoded; of those
    alone whose owners publish that (`PUT /v1/assets/{id}/credentials`).

    Marks are not looked for: a copy without one finds the same manifests. Any API key may ask.
    """
    media = request.headers.get("content-type", "").strip().lower()
    if media and media.partition("/")[0] not in _MEDIA:  # curl sends no Content-Type with -T
        text = f"send the file's bytes as model/*, image/* or application/*, not {media.partition(';')[0]!r}"
        raise Problem("unsupported-media-type", f"{text} (curl --data-binary @FILE)")
    limit = core.settings.matches_per_hour
    await asyncio.to_thread(spend, core.db, f"match:{caller.key_id}", limit, 1, "searches by content of this API key")
    with core.blobs.new_file() as path:
        got = await receive(request.stream(), path, core.settings.max_form_bytes)
        if not got.whole or not got.length:
            raise Problem("malformed-request", "the body is incomplete" if got.length else "no bytes were sent")
        found = await find_alike(core, caller, path) if alg == ALG else []
    return AlikeMatches(matches=[AlikeMatch(manifestId=name, similarityScore=score) for name, score in found[:most]])


@router.get(
    "/manifests/{manifest_id}",
    operation_id="getManifestById",
    response_class=Response,
    responses={**one_file(MEDIA_TYPE, "The manifest store"), **responses("not-found")},
)
def get_manifest(manifest_id: str, core: Core) -> Response:
    """A manifest store, byte for byte as signed. It is bound to the exact file: for a changed copy it names the file
    that this was made from."""
    joined = manifests.join(assets, manifests.c.asset == assets.c.id)
    query = sa.select(manifests.c.sha256).select_from(joined).where(manifests.c.id == manifest_id)
    digest = core.db.query(query).scalar()
    if digest is None:
        raise missing(manifests, manifest_id)
    headers = {"Content-Disposition": 'attachment; filename="manifest.c2pa"'}
    return Response(core.blobs.read(digest), headers=headers, media_type=MEDIA_TYPE)


@router.get("/services/supportedAlgorithms", operation_id="getSupportedBindings", responses=responses())
def get_supported_bindings() -> Algorithms:
    """The soft-binding algorithm that is supported here: ours."""
    return Algorithms(watermarks=[Algorithm(alg=ALG)])
