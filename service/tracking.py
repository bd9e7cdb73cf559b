"""/v1/jobs: where a job stands, its progress as it goes, cancelling it."""

import asyncio
from collections.abc import AsyncIterable
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Header, Query, Response
from fastapi.sse import EventSourceResponse, ServerSentEvent

from service.db import missing
from service.db.schema import jobs
from service.http.access import After, Core, Follower, Limit, Listed, Reader, Uploader, visible
from service.http.error_responses import OF_LIST, OF_OWN, responses
from service.http.file_responses import tags
from service.http.job_responses import JobView, view, views
from service.jobs.durable_jobs import job_of
from service.jobs.port import FINAL, Job, State
from service.problems import Problem

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])
POLL_SECONDS = 0.2
KEEP_ALIVE_SECONDS = 10.0


class JobList(Listed[JobView]):
    """A page of jobs, newest first."""


@router.get("", operation_id="listJobs", responses=OF_LIST)
def list_jobs(
    core: Core,
    caller: Reader,
    state: Annotated[list[State], Query(default_factory=list, description="In this state; repeatable.")],
    limit: Limit = 20,
    after: After = "",
    kind: Annotated[Literal["embed", "verify", "dispute"] | None, Query(description="Of this kind.")] = None,
) -> JobList:
    """Jobs of this tenant, newest first."""
    found = core.jobs.list(caller.tenant, limit + 1, after, state, kind or "")
    following = found[limit - 1].id if len(found) > limit else None
    return JobList(items=views(core, found[:limit]), next=following)


@router.get(
    "/{job_id}",
    operation_id="getJob",
    response_model=JobView,
    responses={304: {"description": "Not modified (If-None-Match)"}, **OF_OWN},
)
def get_job(
    job_id: str,
    core: Core,
    caller: Follower,
    if_none_match: Annotated[str | None, Header(description="ETag of the response that you have.")] = None,
) -> Response:
    """Where a job stands."""
    (job,) = views(core, [found := _found(job_id, core, caller)])
    etag = f'"{found.revision}"' if job.position is None else f'"{found.revision}.{job.position}"'
    headers = {"ETag": etag, "Cache-Control": "no-cache"}
    if etag in tags(if_none_match):
        return Response(status_code=304, headers=headers)
    return Response(job.model_dump_json(), headers=headers, media_type="application/json")


def _found(job_id: str, core: Core, caller: Follower) -> Job:
    return job_of(visible(core, caller, jobs, job_id))


@router.get("/{job_id}/events", operation_id="jobEvents", response_class=EventSourceResponse, responses=OF_OWN)
async def job_events(
    job_id: str, core: Core, caller: Follower, _: Annotated[Job, Depends(_found)]
) -> AsyncIterable[ServerSentEvent]:
    """Server-sent events: the job at every change, of its place in the queue, too, until it has ended."""
    sent, waited = None, 0.0
    while (job := await asyncio.to_thread(core.jobs.get, caller.tenant, job_id)) is not None:
        (seen,) = await asyncio.to_thread(views, core, [job])
        if seen != sent:
            sent, waited = seen, 0.0
            yield ServerSentEvent(data=seen.model_dump(), event="progress", id=str(job.revision))
        if job.state in FINAL:
            return
        await asyncio.sleep(POLL_SECONDS)
        waited += POLL_SECONDS
        if waited >= KEEP_ALIVE_SECONDS:
            waited = 0.0
            yield ServerSentEvent(comment="still here")


@router.delete(
    "/{job_id}",
    status_code=202,
    operation_id="cancelJob",
    responses=responses("unauthorized", "forbidden", "not-found", "conflict"),
)
def cancel_job(job_id: str, core: Core, caller: Uploader) -> JobView:
    """Stop a job: its process is killed, nothing half-written stays. One that has ended is beyond cancelling."""
    visible(core, caller, jobs, job_id)
    job = core.jobs.cancel(caller.tenant, job_id)
    if job is None:
        raise missing(jobs, job_id)
    if job.state in FINAL and job.state is not State.CANCELLED:
        raise Problem("conflict", f"job {job_id!r} has ended: it {job.state.value}")
    return view(job)
