"""Jobs over HTTP: 202 with a place to look, or 200 for who prefers to wait (RFC 7240)."""

import asyncio
import re
from collections.abc import Callable, Mapping
from typing import Any, Literal

from fastapi import Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field

from service.core import Service
from service.http import idempotency
from service.jobs.port import FINAL, Job
from service.problems import Problem, from_json

MAX_WAIT_SECONDS = 60
POLL_SECONDS = 0.1


class JobView(BaseModel):
    """A job as it stands."""

    id: str
    kind: Literal["embed", "verify"]
    state: Literal["queued", "running", "succeeded", "disputed", "failed", "cancelled"]
    stage: str = Field(description="What it is doing.")
    fraction: float = Field(ge=0, le=1, description="How far that stage is.")
    cancelling: bool
    result: dict[str, Any] | None = Field(description="asset_id or claim_id and what to know at once.")
    problem: dict[str, Any] | None = Field(description="Why it failed (RFC 9457).")
    created_at: str
    started_at: str
    finished_at: str


def view(job: Job) -> JobView:
    """The job for the client."""
    return JobView(
        id=job.id,
        kind=job.kind,
        state=job.state.value,
        stage=job.stage,
        fraction=min(max(job.fraction, 0.0), 1.0),
        cancelling=job.cancelling,
        result=dict(job.result) if job.result is not None else None,
        problem=dict(job.problem) if job.problem is not None else None,
        created_at=job.created_at,
        started_at=job.started_at,
        finished_at=job.finished_at,
    )


def submit(service: Service, tenant: str, key: str | None, body: Mapping[str, Any], make: Callable[[], Job]) -> Job:
    """Take a job on, once for each Idempotency-Key.

    Parameters
    ----------
    key : str or None
        The Idempotency-Key.
    body : mapping
        The request with digests in place of files.
    make : callable
        Checks the request, spends budgets, and makes the job.
    """
    if key is None:
        return service.jobs.submit(make())
    first = idempotency.begin(service.db, tenant, key, body)
    if first is not None:
        job = service.jobs.get(tenant, first)
        if job is None:
            raise Problem("not-found", f"the job {first!r} of this Idempotency-Key is gone")
        return job
    try:
        job = service.jobs.submit(make())
    except BaseException:
        idempotency.release(service.db, tenant, key)
        raise
    idempotency.settle(service.db, tenant, key, job.id)
    return job


async def respond(service: Service, job: Job, prefer: str | None) -> Response:
    """202 and where to look; 200 once the job has ended within the time that the client prefers to wait.

    Raises
    ------
    Problem
        What the job failed with, where that is the client's to mend.
    """
    seconds = wait_seconds(prefer)
    if seconds:
        job = await _wait(service, job, seconds)
    headers = {"Location": f"/v1/jobs/{job.id}"}
    if seconds:
        headers["Preference-Applied"] = f"wait={seconds}"
    if job.state not in FINAL:
        return JSONResponse(view(job).model_dump(), 202, {**headers, "Retry-After": "1"})
    if job.problem is not None and 400 <= int(job.problem["status"]) < 500:
        problem = from_json(job.problem)
        problem.extra["job"] = job.id
        raise problem
    return JSONResponse(view(job).model_dump(), 200, headers)


async def _wait(service: Service, job: Job, seconds: int) -> Job:
    until = asyncio.get_running_loop().time() + seconds
    while job.state not in FINAL and asyncio.get_running_loop().time() < until:
        await asyncio.sleep(POLL_SECONDS)
        found = await asyncio.to_thread(service.jobs.get, job.tenant, job.id)
        job = found or job
    return job


def wait_seconds(prefer: str | None) -> int:
    """Seconds of `Prefer: wait=N`, at most MAX_WAIT_SECONDS; 0 without."""
    found = re.search(r"(?:^|[,;\s])wait\s*=\s*\"?(\d{1,6})", prefer or "")
    return min(int(found.group(1)), MAX_WAIT_SECONDS) if found else 0
