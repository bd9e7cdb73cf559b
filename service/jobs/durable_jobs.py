"""The job engine: the `jobs` table says where a job stands, DBOS runs it to its end whatever dies.

What DBOS does not offer, and is therefore here: turns of tenants (it dequeues the partitions of a queue in random
order, so a job would have no place in the queue), and finding workers that died (`presence`). On SQLite the two have a
file each, so a job can be in one and not yet in the other: `reconcile` mends that.
"""

from __future__ import annotations

import logging
import sqlite3
import threading
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa

from service.clock import ago
from service.db import Database
from service.db.database import POSTGRES_CONNECT
from service.db.schema import jobs
from service.jobs.port import Job, State
from service.jobs.presence import Presence
from service.jobs.rows import Rows
from service.problems import Problem

if TYPE_CHECKING:
    from dbos import DBOSClient, DBOSConfig

APPLICATION = "mark3dgs"
VERSION = "1"
"""Workers of every release share the jobs: a job outlives an update of the program."""

QUEUE = "jobs"
WORKFLOW = "job"

_SETTLED_HOURS = 5 / 3600
"""A submit that has not enqueued its job by then has died, or found the engine's tables out of reach."""

_PAGE = 500

_log = logging.getLogger(__name__)


class DurableJobs(Rows):
    """The rows of jobs, and the engine (with tables of its own, at `jobs_url`) that runs them."""

    def __init__(self, db: Database, jobs_url: str) -> None:
        super().__init__(db)
        self.url = jobs_url
        self.presence = Presence(db)
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

    def begin(self, job_id: str, worker: str) -> Job | None:
        """As of the row; the next job of its tenant takes its place in the queue."""
        job = super().begin(job_id, worker)
        if job is not None:
            self._advance(job.tenant)
        return job

    def cancel(self, tenant: str, job_id: str) -> Job | None:
        """As of the row; a job that no worker has begun leaves the queue, so that it costs no worker a turn.

        DBOS's own cancelling ends a job between two steps; one at work is ended within its step, by `progress`.
        """
        job = super().cancel(tenant, job_id)
        if job is not None and job.state == State.CANCELLED and not job.started_at:
            try:
                self.client().cancel_workflow(job_id)
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
            silent = self.presence.silent(set(self.taken().values()), silent_seconds)
        except Exception:
            self.presence.start_over()
            raise
        silent = [worker for worker in silent if worker != but and self.presence.strike_off(worker)]
        for worker in silent:  # should we die here, its jobs have an owner without a row, who is silent as well
            self.requeue([job_id for job_id, owner in self.taken().items() if owner == worker])
        return silent

    def taken(self) -> dict[str, str]:
        """Jobs that a worker has taken from the queue and not ended, and whose they are."""
        pending = self.client().list_workflows(status="PENDING", load_input=False, load_output=False)
        return {workflow.workflow_id: workflow.executor_id or "" for workflow in pending}

    def requeue(self, job_ids: Collection[str]) -> None:
        """Put jobs back in the queue. They go on at their last finished step; DBOS lets one who lost a job record no
        further step of it."""
        if job_ids:
            _log.warning("taken over: jobs %s", ", ".join(job_ids))
            self.client().resume_workflows(list(job_ids), queue_name=QUEUE)

    def reconcile(self) -> None:
        """Mend what a death between two databases left: jobs never enqueued, and jobs that ended without saying so."""
        waiting = self.due_before(ago(_SETTLED_HOURS))
        for start in range(0, len(waiting), _PAGE):
            page = waiting[start : start + _PAGE]
            found = self.client().list_workflows(workflow_ids=list(page), load_input=False, load_output=False)
            status = {workflow.workflow_id: workflow.status for workflow in found}
            for job_id in page:
                if job_id not in status:
                    self._enqueue(job_id)
                elif status[job_id] not in ("ENQUEUED", "PENDING", "DELAYED"):
                    _log.error("job %s ended as %s and said nothing", job_id, status[job_id])
                    problem = Problem("internal", "the work ended without a result")
                    self.result(job_id, State.FAILED, problem.to_json())

    def prune(self, hours: float) -> int:
        """Forget jobs that ended so long ago, here and in the engine's tables; how many."""
        old = self.ended_before(ago(hours))
        for start in range(0, len(old), _PAGE):
            page = list(old[start : start + _PAGE])
            self.client().delete_workflows(page)
            with self._db.write() as connection:
                connection.execute(sa.delete(jobs).where(jobs.c.id.in_(page)))
        return len(old)

    def close(self) -> None:
        """Give connections back."""
        with self._lock:
            if self._opened is not None:
                self._opened.destroy()
                self._opened = None

    def client(self) -> DBOSClient:
        """DBOS as one who runs no job sees it. Opened on first use: the library takes most of a second to import."""
        with self._lock:
            if self._opened is None:
                _hush()
                from dbos import DBOS, DBOSClient, DBOSPortableJSONSerializer

                if sa.make_url(self.url).get_backend_name() == "sqlite":
                    with sqlite3.connect(str(sa.make_url(self.url).database), timeout=30) as connection:
                        connection.execute("PRAGMA journal_mode=WAL")  # kept in the file
                    connection.close()
                DBOS.migrate(_with_limits(self.url))
                self._opened = DBOSClient(
                    system_database_url=_with_limits(self.url),
                    serializer=DBOSPortableJSONSerializer(),
                    application_name=APPLICATION,
                    lazy=True,
                    retry_connection_errors=False,  # a request does not wait for a dead database
                )
            return self._opened

    def _advance(self, tenant: str) -> None:
        """Keep the tenant's oldest job in the queue; the fewer of its jobs are at work, the further in front."""
        try:
            if (found := self.next_of(tenant)) is not None:
                self._enqueue(*found)
        except Exception as error:  # the row is what counts: `reconcile` makes up for it
            _log.warning("the next job of tenant %s is enqueued later: %s", tenant, error)

    def _enqueue(self, job_id: str, at_work: int = 0) -> None:
        """Once for each id; jobs of one priority run in their order of coming."""
        options: Any = {"workflow_name": WORKFLOW, "queue_name": QUEUE, "workflow_id": job_id, "priority": 1 + at_work}
        self.client().enqueue(options, job_id)


def configuration(url: str, executor: str) -> DBOSConfig:
    """DBOS in a worker: silent, on our database, no services of its maker, values as JSON."""
    _hush()
    from dbos import DBOSPortableJSONSerializer

    return {
        "name": APPLICATION,
        "system_database_url": _with_limits(url),
        "application_version": VERSION,
        "executor_id": executor,
        "serializer": DBOSPortableJSONSerializer(),  # the default, pickle, runs what it reads
        "sys_db_pool_size": 5,
        "log_level": "ERROR",
        "enable_otlp": False,
    }


def _hush() -> None:
    """Keep DBOS off the console: its messages go to the program's log, errors only."""
    log = logging.getLogger("dbos")
    log.setLevel(logging.ERROR)
    if not log.handlers:  # finding one, DBOS adds none of its own
        log.addHandler(logging.NullHandler())


def _with_limits(url: str) -> str:
    """The URL, on PostgreSQL with the time limits of our own connections."""
    address = sa.make_url(url)
    if address.get_backend_name() == "sqlite":
        return url
    limits = {name: str(value) for name, value in POSTGRES_CONNECT.items()}
    return address.update_query_dict(limits).render_as_string(hide_password=False)
