"""Jobs over HTTP: 202 with the job's address, or 200 where the client prefers to wait (RFC 7240)."""

import asyncio
import re
import secrets
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal

from fastapi import Header, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, BeforeValidator, Field

from service.core import Service
from service.http import idempotency
from service.http.error_responses import Responses, responses
from service.http.results import Failure, Result, Time, TimeOrNot
from service.jobs.durable_jobs import too_many
from service.jobs.port import FINAL, Job, State
from service.problems import Problem, from_json
from service.trust.api_keys import Caller

MAX_WAIT_SECONDS = 60
POLL_SECONDS = 0.1
_WITHIN = BeforeValidator(lambda fraction: min(max(fraction, 0.0), 1.0))


class JobView(BaseModel):
    """A job and its state."""

    id: str
    kind: Literal["embed", "verify", "dispute"]
    state: Literal["queued", "running", "succeeded", "disputed", "failed", "cancelled"]
    name: str = Field(description="Subject: the label, or the names of the files; empty if none was given.")
    copy_name: str = Field(description="Recipient of the marked copy; empty for none.")
    stage: str = Field(description="The stage at work.")
    fraction: Annotated[float, Field(ge=0, le=1, description="Progress of that stage."), _WITHIN]
    fraction_total: float | None = Field(
        ge=0, le=1, description="Progress of the whole job, by the usual time of its stages; null if unknown."
    )
    cancelling: bool
    position: int | None = Field(
        ge=1,
        description="Place in the queue, 1 is next at present; null unless queued. Tenants take turns: later"
        " jobs of tenants with fewer jobs may still go first.",
    )
    result: Result = Field(description="asset_id or claim_id, and the main results; null until it succeeded.")
    problem: Failure | None = Field(description="Why it failed (RFC 9457).")
    created_at: Time
    started_at: TimeOrNot
    finished_at: TimeOrNot


Prefer = Annotated[str | None, Header(description="wait=N: answer 200 if it ends within N seconds.")]
RetryKey = Annotated[str | None, Header(min_length=1, max_length=128)]
JOB_RESPONSES: Responses = {
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
}
"""Of a request that becomes a job."""


def view(job: Job, position: int | None = None) -> JobView:
    """The job for the client."""
    name = job.request.get("label") or ", ".join(job.request.get("names") or ())
    subject = {"name": name, "copy_name": job.request.get("copy_name", "")}
    return JobView.model_validate({**vars(job), "fraction_total": course(job), "position": position, **subject})


def views(service: Service, jobs: Sequence[Job]) -> list[JobView]:
    """Jobs for the client, those that wait with their places in the queue."""
    places = service.jobs.positions(jobs)
    return [view(job, places.get(job.id)) for job in jobs]


def submit(
    service: Service,
    caller: Caller,
    kind: str,
    key: str | None,
    body: Mapping[str, Any],
    make: Callable[[], Mapping[str, Any]],
) -> Job:
    """Accept a job, once for each Idempotency-Key (`key`).

    It stands for `body`: the request with digests in place of files. `make` checks the request, spends budgets, and
    returns the job's own request.
    """

    def take_on() -> Job:
        most = service.settings.queued_jobs
        if service.jobs.waiting(caller.tenant) >= most:  # before budgets are spent; `submit` checks it again
            raise too_many(most)
        request = make()
        job_id = f"job_{secrets.token_hex(12)}"
        return service.jobs.submit(Job(job_id, caller.tenant, caller.key_id, kind, State.QUEUED, request), most)

    if key is None:
        return take_on()
    first = idempotency.begin(service.db, caller, key, body)
    if first is not None:
        job = service.jobs.get(caller.tenant, first)
        if job is None:
            raise Problem("not-found", f"the job {first!r} of this Idempotency-Key is gone")
        return job
    try:
        job = take_on()
    except BaseException:
        idempotency.release(service.db, caller, key)
        raise
    idempotency.settle(service.db, caller, key, job.id)
    return job


async def respond(service: Service, job: Job, prefer: str | None) -> Response:
    """202 and where to look; 200 once the job has ended within the time that the client prefers to wait.

    The job's error is raised, where the client can correct it.
    """
    seconds = wait_seconds(prefer)
    if seconds:
        job = await _wait(service, job, seconds)
    headers = {"Location": f"/v1/jobs/{job.id}"}
    if seconds:
        headers["Preference-Applied"] = f"wait={seconds}"
    if job.state not in FINAL:
        (seen,) = await asyncio.to_thread(views, service, [job])
        return JSONResponse(seen.model_dump(), 202, {**headers, "Retry-After": "1"})
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


# Share of each stage in the time of a job, measured on 100,000 Gaussians and two cores (docs/RESULTS.md, "The
# service"); larger models move shares by a tenth.
_EMBED = {"screen": 5, "read": 1, "choose": 0, "look": 14, "prune": 1, "quantize": 2, "landmarks": 46, "plan": 20}
_EMBED |= {"mark": 7, "record": 1, "write": 1, "picture": 2, "commit": 0}
_PRUNED = {"prune": 600}  # by a budget: what is left is fitted to the original's renders
_AUTO = _EMBED | {"choose": 37, "look": 1, "plan": 5, "mark": 2}
_MODEL = {"screen": 10, "read": 1, "open record": 5, "register": 17, "model": 8, "decide": 4, "picture": 55}
_MODEL |= {"commit": 0}
_PICTURE = {"screen": 10, "read": 1, "open record": 2, "find camera": 30, "read picture": 40, "decide": 2}
_PICTURE |= {"picture": 15, "commit": 0}


def course(job: Job) -> float | None:
    """Share of the whole job that is done, 0 to 1; None where that cannot be said."""
    if job.state is State.QUEUED:
        return 0.0
    if job.state in FINAL:
        return 1.0 if job.state in (State.SUCCEEDED, State.DISPUTED) else None
    pictures = len(job.request.get("images") or ())
    if pictures > 1 or job.kind == "dispute":  # they go through the same stages again and again
        return None
    chosen = job.request.get("profile") == "auto"
    shares = (_AUTO if chosen else _EMBED) if job.kind == "embed" else _PICTURE if pictures else _MODEL
    shares = shares | _PRUNED if job.request.get("budget") else shares
    stage = job.stage.partition(": ")[0]  # what is reached may follow
    if stage not in shares:  # kernels are compiled, or one of several records is tested
        return None
    before = sum(list(shares.values())[: list(shares).index(stage)])
    return (before + shares[stage] * min(max(job.fraction, 0.0), 1.0)) / sum(shares.values())
