"""The port in memory: the shortest thing that keeps its promises while no worker dies."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from service.clock import now
from service.jobs.port import FINAL, Job, State
from service.problems import Problem


class FakeJobs:
    """As much of `DurableJobs` as handlers see; `begin`, `beat` and `leave` are what a worker does behind it."""

    def __init__(self) -> None:
        self._jobs: dict[str, Job] = {}
        self._seen: dict[str, float] = {}

    def submit(self, job: Job, most: int | None = None) -> Job:
        fresh = replace(job, state=State.QUEUED, created_at=job.created_at or now())
        return self._jobs.setdefault(job.id, fresh)

    def get(self, tenant: str, job_id: str) -> Job | None:
        job = self._jobs.get(job_id)
        return job if job and job.tenant == tenant else None

    def list(
        self, tenant: str, limit: int = 20, after: str = "", states: Collection[str] = (), kind: str = ""
    ) -> Sequence[Job]:
        mine = [job for job in self._jobs.values() if job.tenant == tenant]
        mine = [job for job in mine if job.state in (states or [job.state]) and job.kind == (kind or job.kind)]
        mine.sort(key=lambda job: (job.created_at, job.id), reverse=True)
        if after:
            places = [number for number, job in enumerate(mine) if job.id == after]
            if not places:
                raise Problem("invalid-request", f"after: {after!r} is not a valid cursor of this list")
            mine = mine[places[0] + 1 :]
        return mine[:limit]

    def cancel(self, tenant: str, job_id: str) -> Job | None:
        job = self.get(tenant, job_id)
        if job and job.state == State.QUEUED:
            self._change(job_id, state=State.CANCELLED, cancelling=True, finished_at=now())
        elif job and job.state == State.RUNNING and not job.cancelling:
            self._change(job_id, cancelling=True)
        return self.get(tenant, job_id)

    def progress(self, job_id: str, stage: str, fraction: float) -> bool:
        job = self._jobs.get(job_id)
        if job is None or job.state != State.RUNNING or job.cancelling:
            return False
        if (job.stage, job.fraction) != (stage, fraction):
            self._change(job_id, stage=stage, fraction=fraction)
        return True

    def result(self, job_id: str, state: State, value: Mapping[str, Any]) -> None:
        if state not in FINAL:
            raise ValueError(state)
        if job_id not in self._jobs or self._jobs[job_id].state in FINAL:
            return
        if state in (State.SUCCEEDED, State.DISPUTED):
            self._change(job_id, state=state, result=value, fraction=1.0, finished_at=now())
        else:
            problem = value if state == State.FAILED else None
            self._change(job_id, state=state, problem=problem, finished_at=now())

    def recover(self, silent_seconds: float) -> Sequence[str]:
        silent = [worker for worker, seen in self._seen.items() if time.monotonic() - seen >= silent_seconds]
        for worker in silent:
            del self._seen[worker]
        return silent

    def begin(self, job_id: str, worker: str) -> None:
        if job_id in self._jobs and self._jobs[job_id].state not in FINAL:
            started = self._jobs[job_id].started_at or now()
            self._change(job_id, state=State.RUNNING, started_at=started)

    def beat(self, worker: str) -> None:
        self._seen[worker] = time.monotonic()

    def leave(self, worker: str) -> None:
        self._seen[worker] = float("-inf")

    def _change(self, job_id: str, **values: Any) -> None:
        job = self._jobs[job_id]
        self._jobs[job_id] = replace(job, revision=job.revision + 1, **values)
