"""The job engine: our table says where a job stands, DBOS sees to it that it is done whatever dies.

Tenants take turns: of each tenant one job at a time, its oldest, stands in DBOS's queue, and those stand first whose
tenant had the fewest at work.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

from service.clock import ago
from service.db import Database
from service.jobs import dbos_setup
from service.jobs.port import Job, State
from service.jobs.presence import Presence, Watch
from service.jobs.rows import Attempt, Rows
from service.problems import Problem

if TYPE_CHECKING:
    from dbos import DBOSClient

_SETTLED_HOURS = 5 / 3600
"""A submit that has not enqueued its job by then has died, or found the engine's tables out of reach."""

_PAGE = 500

_log = logging.getLogger(__name__)


class DurableJobs(Rows):
    """The rows of jobs, and the engine (with tables of its own, at `jobs_url`) that sees to it that they are done."""

    def __init__(self, db: Database, jobs_url: str) -> None:
        super().__init__(db)
        self.url = jobs_url
        self.presence = Presence(db)
        self._watch = Watch()
        self._lock = threading.Lock()
        self._opened: DBOSClient | None = None

    def submit(self, job: Job) -> Job:
        """Take a job on; when this returns, it will be done whatever dies. The same id twice is one job."""
        known = self.add(job)
        if known is None:
            raise Problem("conflict", f"the job id {job.id!r} is taken")
        if known.state == State.QUEUED:
            self._advance(known.tenant)
        return known

    def begin(self, job_id: str, worker: str) -> Attempt | None:
        """As of the row; the next job of its tenant takes its place in the queue."""
        attempt = super().begin(job_id, worker)
        if attempt is not None:
            self._advance(attempt.job.tenant)
        return attempt

    def cancel(self, tenant: str, job_id: str) -> Job | None:
        """As of the row; a job that nobody has begun leaves the queue, so that it costs no worker a turn."""
        job = super().cancel(tenant, job_id)
        if job is not None and job.state == State.CANCELLED and not job.started_at:
            try:
                self._client().cancel_workflow(job_id)
            except Exception as error:  # a worker takes it, and finds nothing to do
                _log.warning("job %s stays in the queue: %s", job_id, error)
            self._advance(tenant)
        return job

    def recover(self, silent_seconds: float, but: str = "") -> Sequence[str]:
        """Take over the jobs of workers not heard of for that long; ids of those workers.

        Silence is measured from the first call that saw it, so a single call finds only workers that left. A worker
        does not judge itself: that is `but`.
        """
        try:
            seen = self.presence.seen()
            silent = self._watch.silent(seen, {owner for _, owner in self._pending()}, silent_seconds)
        except Exception:
            self._watch.start_over()
            raise
        silent = [worker for worker in silent if worker != but]
        for worker in silent:
            # First the jobs, then the row: dying in between, we leave the worker to be found again. Any number of
            # others may do the same, for only jobs that are still that worker's go back to the queue.
            self.requeue(worker, self.held(worker))
            if worker in seen:
                self.presence.forget(worker, seen[worker])
        return silent

    def held(self, worker: str) -> set[str]:
        """Jobs that a worker has taken from the queue and not ended."""
        return {job_id for job_id, owner in self._pending() if owner == worker}

    def requeue(self, worker: str, job_ids: Collection[str]) -> None:
        """Put jobs back in the queue, those that are still this worker's. They go on at their last finished step."""
        # DBOS's own recovery step, which its public form offers for the executor of this process only.
        system = self._client()._sys_db
        for job_id in job_ids:
            if system.reenqueue_for_recovery(job_id, [worker], dbos_setup.QUEUE):
                _log.warning("job %s is taken over from worker %s", job_id, worker)

    def reconcile(self) -> None:
        """Mend what a death between two databases left: jobs never enqueued, and jobs that ended without saying so."""
        waiting = self.due_before(ago(_SETTLED_HOURS))
        for start in range(0, len(waiting), _PAGE):
            page = dict(waiting[start : start + _PAGE])
            found = self._client().list_workflows(workflow_ids=list(page), load_input=False, load_output=False)
            status = {workflow.workflow_id: workflow.status for workflow in found}
            for job_id, tenant in page.items():
                if job_id not in status:
                    self._enqueue(job_id, tenant)
                elif status[job_id] not in ("ENQUEUED", "PENDING", "DELAYED"):
                    _log.error("job %s ended as %s and said nothing", job_id, status[job_id])
                    problem = Problem("internal", "the work ended without a result")
                    self.result(job_id, State.FAILED, problem.to_json())

    def prune(self, hours: float) -> int:
        """Forget jobs that ended so long ago, here and in the engine's tables; how many."""
        old = self.ended_before(ago(hours))
        for start in range(0, len(old), _PAGE):
            self._client().delete_workflows(list(old[start : start + _PAGE]))
            self.remove(old[start : start + _PAGE])
        return len(old)

    def close(self) -> None:
        """Give connections back."""
        with self._lock:
            if self._opened is not None:
                self._opened.destroy()
                self._opened = None

    def _client(self) -> DBOSClient:
        with self._lock:  # opened on first use: the engine's library takes most of a second to import
            if self._opened is None:
                dbos_setup.migrate(self.url)
                self._opened = dbos_setup.client(self.url)
            return self._opened

    def _advance(self, tenant: str) -> None:
        """See to it that the tenant's oldest job stands in the queue; the row is what counts, `reconcile` makes up."""
        try:
            if (job_id := self.oldest(tenant)) is not None:
                self._enqueue(job_id, tenant)
        except Exception as error:
            _log.warning("the next job of tenant %s is enqueued later: %s", tenant, error)

    def _enqueue(self, job_id: str, tenant: str) -> None:
        """Once for each id. The fewer jobs of the tenant are at work, the sooner; equals in their order of coming."""
        options: Any = {"workflow_name": dbos_setup.WORKFLOW, "queue_name": dbos_setup.QUEUE, "workflow_id": job_id}
        self._client().enqueue(options | {"priority": 1 + self.running(tenant)}, job_id)

    def _pending(self) -> Sequence[tuple[str, str]]:
        """Jobs that were taken from the queue, and by whom."""
        pending = self._client().list_workflows(status="PENDING", load_input=False, load_output=False)
        return [(workflow.workflow_id, workflow.executor_id or "") for workflow in pending]
