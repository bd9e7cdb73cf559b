"""/healthz, /readyz and /metrics: is it alive, is it ready, what does it do."""

import time

import sqlalchemy as sa
from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Gauge, generate_latest
from pydantic import BaseModel

from service.core import Service
from service.db.schema import assets, claims, jobs, workers
from service.http.access import Core, Operator
from service.http.error_responses import responses
from service.problems import Problem

router = APIRouter(tags=["health"])
LEAST_FREE_BYTES = 1 << 30


class Alive(BaseModel):
    """The process answers."""

    status: str


class Ready(BaseModel):
    """What a job needs, part by part."""

    status: str
    database: bool
    disk: bool
    workers: int


@router.get("/healthz", operation_id="healthz", responses=responses())
async def healthz() -> Alive:
    """The process is alive. Looks at nothing else, so it answers at once."""
    return Alive(status="ok")


@router.get(
    "/readyz",
    operation_id="readyz",
    response_model=Ready,
    responses={
        503: {"model": Ready, "description": "Not ready"},
        **{status: text for status, text in responses().items() if status != 503},
    },
)
def readyz(core: Core) -> Response:
    """Whether database, disk and at least one worker are there."""
    disk = core.blobs.free_bytes() >= LEAST_FREE_BYTES
    try:
        alive, database = _workers(core), True
    except Problem:
        alive, database = 0, False
    good = database and disk and alive > 0
    found = Ready(status="ready" if good else "not ready", database=database, disk=disk, workers=alive)
    return JSONResponse(found.model_dump(), 200 if good else 503)


@router.get(
    "/metrics",
    operation_id="metrics",
    response_class=Response,
    responses={
        200: {"content": {"text/plain": {"schema": {"type": "string"}}}, "description": "Prometheus text format"},
        **responses("unauthorized", "forbidden"),
    },
)
def metrics(core: Core, caller: Operator) -> Response:
    """Counts of jobs by kind and state, assets, claims, workers; sizes of queue and disk: of all tenants together, so
    for a key with the scope `operator`."""
    registry = CollectorRegistry()
    by_state = Gauge("mark3dgs_jobs", "Jobs by kind and state", ["kind", "state"], registry=registry)
    count = sa.select(sa.func.count())
    with core.db.read() as connection:
        for row in connection.execute(count.add_columns(*(kinds := (jobs.c.kind, jobs.c.state))).group_by(*kinds)):
            by_state.labels(row.kind, row.state).set(row[0])
        for table in (assets, claims):
            rows = connection.execute(count.select_from(table)).scalar_one()
            Gauge(f"mark3dgs_{table.name}", f"Rows in {table.name}", registry=registry).set(rows)
    Gauge("mark3dgs_workers", "Workers seen lately", registry=registry).set(_workers(core))
    Gauge("mark3dgs_disk_free_bytes", "Free bytes for scratch files", registry=registry).set(core.blobs.free_bytes())
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)


def _workers(core: Service) -> int:
    lately = workers.c.seen_at >= time.time() - core.settings.worker_silence_seconds
    return int(core.db.query(sa.select(sa.func.count()).select_from(workers).where(lately)).scalar_one())
