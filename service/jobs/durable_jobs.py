"""The job engine: the `jobs` table says where a job stands, DBOS runs it to its end whatever dies.

DBOS knows a workflow as queued, pending or ended, and learns of a step once it is over. What happens within a step is
in the table: how far it is, that it is to stop, that another worker has the job by now, and how many workers it has
cost. So is a job's end, since its transaction writes the messages to webhooks. Every change is one conditional
statement; a final job never changes.

What DBOS does not offer, and is therefore here: turns of tenants (it dequeues the partitions of a queue in random
order, so a job would have no place in the queue), and finding workers that died (`Presence`). On SQLite the two have a
file each, so a job can be in one and not yet in the other: `reconcile` mends that.
"""

from __future__ import annotations

import json
import logging
import os
import socket
import sqlite3
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from service.clock import ago, now, seconds_until
from service.db import Database, page
from service.db.database import POSTGRES_CONNECT
from service.db.schema import ENDED, deliveries, jobs, webhooks, workers
from service.jobs.port import FINAL, Job, State
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

LEFT = 0.0
"""`seen_at` of a worker that shut down: its jobs can be taken over at once."""

_log = logging.getLogger(__name__)


_OPEN = jobs.c.state.not_in([state.value for state in FINAL])
_QUEUED = jobs.c.state == State.QUEUED.value
_RUNNING = jobs.c.state == State.RUNNING.value
_ORDER = (jobs.c.created_at, jobs.c.id)
_CHANGED: dict[str, object] = {"revision": jobs.c.revision + 1}


class Presence:
    """Which workers are alive: each writes a row every few seconds, and each watches the others' rows.

    DBOS recovers the jobs of an executor when a process starts under that executor's name. That another one died is
    noticed by its hosted console alone.

    Silence is measured by the clock of the process that watches: clocks of several machines are never compared, and a
    time in which the database did not answer counts for no worker.
    """

    def __init__(self, db: Database) -> None:
        self._db = db
        self._since: dict[str, tuple[float | None, float]] = {}  # last sign of life, and when it was first seen here

    def beat(self, worker: str) -> None:
        """Report that this worker is alive."""
        row = {"host": socket.gethostname(), "pid": os.getpid(), "seen_at": time.time()}
        with self._db.write() as connection:
            if not connection.execute(sa.update(workers).where(workers.c.id == worker).values(row)).rowcount:
                connection.execute(workers.insert().values(row | {"id": worker, "started_at": now()}))

    def leave(self, worker: str) -> None:
        """Report that this worker shuts down."""
        self._db.change(sa.update(workers).where(workers.c.id == worker).values(seen_at=LEFT))

    def silent(self, owners: Collection[str], seconds: float) -> list[str]:
        """Workers that left, or whose row has not changed for that long; owners of jobs without a row count as well."""
        signs: dict[str, float | None] = dict.fromkeys(owners)
        signs |= {row.id: row.seen_at for row in self._db.query(sa.select(workers))}
        moment = time.monotonic()
        self._since = {
            worker: old if (old := self._since.get(worker)) and old[0] == sign else (sign, moment)
            for worker, sign in signs.items()
        }
        return [worker for worker, (sign, since) in self._since.items() if sign == LEFT or moment - since >= seconds]

    def start_over(self) -> None:
        """Forget the silence seen so far: the database did not answer for a while."""
        self._since.clear()

    def strike_off(self, worker: str) -> bool:
        """Delete the row of a worker that `silent` named; False where it gave a sign of life since, or another process
        was first."""
        sign = self._since[worker][0]
        if sign is None:
            return True
        with self._db.write() as connection:
            this = (workers.c.id == worker) & (workers.c.seen_at == sign)
            return connection.execute(sa.delete(workers).where(this)).rowcount > 0


class DurableJobs:
    """The rows of jobs, and the engine (with tables of its own, at `jobs_url`) that runs them."""

    def __init__(self, db: Database, jobs_url: str) -> None:
        self._db, self.url = db, jobs_url
        self.presence = Presence(db)
        self._lock = threading.Lock()
        self._opened: DBOSClient | None = None

    def submit(self, job: Job, most: int | None = None) -> Job:
        """Accept a job; when this returns, it will be done whatever dies. The same id twice is one job.

        `too_many` where as many as `most` jobs of its tenant are not final.
        """
        values = {name: getattr(job, name) for name in ("id", "tenant", "api_key", "kind")}
        values |= {"state": State.QUEUED.value, "stage": "", "created_at": job.created_at or now()}
        values |= {"request": json.dumps(job.request, sort_keys=True)}
        with suppress(IntegrityError), self._db.exclusive() as connection:  # the id is taken: the same job sent again
            if most is not None and connection.execute(_waiting(job.tenant)).scalar_one() >= most:
                raise too_many(most)
            connection.execute(jobs.insert().values(values))
        known = self.get(job.tenant, job.id)
        if known is None:
            raise Problem("conflict", f"the job id {job.id!r} is taken")
        if known.state == State.QUEUED:
            self._advance(known.tenant)
        return known

    def get(self, tenant: str, job_id: str) -> Job | None:
        """A tenant's job."""
        row = self._db.query(sa.select(jobs).where(_mine(tenant, job_id))).first()
        return None if row is None else job_of(row)

    def list(
        self, tenant: str, limit: int = 20, after: str = "", states: Collection[str] = (), kind: str = ""
    ) -> Sequence[Job]:
        """Jobs of a tenant, newest first, after the job with this id; those in these states, and of this kind."""
        where = sa.and_(jobs.c.state.in_(states or list(State)), jobs.c.kind == kind if kind else sa.true())
        with self._db.read() as connection:
            return [job_of(row) for row in page(connection, jobs, tenant, limit, after, where=where)[0]]

    def positions(self, listed: Sequence[Job]) -> dict[str, int]:
        """Places in the queue of those jobs that wait, by id: 1 is begun next, at present.

        Of all tenants' jobs, as they take turns: the first job of each tenant before the second of any, a tenant with
        jobs at work so many turns later, equals in their order of coming. Later jobs of a tenant with fewer go first.
        """
        waiting = [job.id for job in listed if job.state is State.QUEUED]
        if not waiting:
            return {}
        # Those at work come first in this numbering of a tenant's jobs: its first job that waits has so many before it.
        first = (jobs.c.state != State.RUNNING.value, *_ORDER)
        turn = sa.func.row_number().over(partition_by=jobs.c.tenant, order_by=first).label("turn")
        known = sa.select(*_ORDER, jobs.c.state, turn).where(_OPEN & (jobs.c.created_at <= now())).subquery()
        queue = sa.select(known).where(known.c.state == State.QUEUED.value).subquery()
        place = sa.func.row_number().over(order_by=(queue.c.turn, queue.c.created_at, queue.c.id)).label("place")
        places = sa.select(queue.c.id, place).subquery()
        with self._db.read() as connection:
            found = connection.execute(sa.select(places).where(places.c.id.in_(waiting)))
            return {row.id: row.place for row in found}

    def progress(self, job_id: str, stage: str, fraction: float, attempt: int | None = None) -> bool:
        """Report a job's progress. False: cancellation was requested (or the job is gone, or another's); stop."""
        held = jobs.c.attempts == attempt if attempt is not None else sa.true()
        going_on = (jobs.c.id == job_id) & held & _RUNNING & sa.not_(jobs.c.cancelling)
        row = self._db.query(sa.select(jobs.c.stage, jobs.c.fraction).where(going_on)).first()
        if row is None or row == (stage, fraction):
            return row is not None
        with self._db.write() as connection:
            said = {"stage": stage, "fraction": fraction} | _CHANGED
            return connection.execute(sa.update(jobs).where(going_on).values(said)).rowcount > 0

    def result(self, job_id: str, state: State, value: Mapping[str, Any]) -> None:
        """End a job: `value` is its result, or its problem where it failed. A final job stays as it is."""
        if state not in FINAL:
            raise ValueError(f"{state} is no final state")
        ended: dict[str, object] = {"state": state.value, "finished_at": now()}
        if state in (State.SUCCEEDED, State.DISPUTED):
            ended |= {"result": json.dumps(value, sort_keys=True), "fraction": 1.0}
        elif state == State.FAILED:
            ended |= {"problem": json.dumps(value, sort_keys=True)}
        with self._db.write() as connection:
            this = (jobs.c.id == job_id) & _OPEN
            if connection.execute(sa.update(jobs).where(this).values(ended | _CHANGED)).rowcount:
                tenant = sa.select(jobs.c.tenant).where(jobs.c.id == job_id).scalar_subquery()
                announce(connection, ENDED, tenant, job_id)

    def settled(self, job: Job) -> None:
        """A step of a job, as it was begun, is done: what is tried next is another."""
        held = (jobs.c.id == job.id) & (jobs.c.attempts == job.attempts)
        self._db.change(sa.update(jobs).where(held).values(tries=1))

    def handed_back(self, worker: str) -> None:
        """A worker shuts down: this counts as no failed attempt of its jobs."""
        its = (jobs.c.worker == worker) & _RUNNING & (jobs.c.tries > 0)
        self._db.change(sa.update(jobs).where(its).values(tries=jobs.c.tries - 1))

    def waiting(self, tenant: str) -> int:
        """How many jobs of a tenant are not final."""
        return int(self._db.query(_waiting(tenant)).scalar_one())

    def begin(self, job_id: str, worker: str) -> Job | None:
        """A worker starts on a job, for the first time or again; None where there is nothing left to do. The next job
        of its tenant takes its place in the queue."""
        begun = {
            "state": State.RUNNING.value,
            "worker": worker,
            "attempts": jobs.c.attempts + 1,
            "tries": jobs.c.tries + 1,
            "started_at": sa.func.coalesce(jobs.c.started_at, now()),
        }
        this = jobs.c.id == job_id
        with self._db.write() as connection:
            if not connection.execute(sa.update(jobs).where(this & _OPEN).values(begun | _CHANGED)).rowcount:
                return None
            job = job_of(connection.execute(sa.select(jobs).where(this)).one())
        self._advance(job.tenant)
        return job

    def cancel(self, tenant: str, job_id: str) -> Job | None:
        """A queued job is cancelled at once, and leaves DBOS's queue so that it costs no worker a turn; a running one
        is to stop. DBOS's own cancelling ends a job between two steps; `progress` ends one at work within its step."""
        mine = _mine(tenant, job_id)
        queued = mine & _QUEUED
        running = mine & _RUNNING & sa.not_(jobs.c.cancelling)
        ended = {"state": State.CANCELLED.value, "cancelling": True, "finished_at": now()}
        with self._db.write() as connection:
            if connection.execute(sa.update(jobs).where(queued).values(ended | _CHANGED)).rowcount:
                announce(connection, ENDED, tenant, job_id)
            connection.execute(sa.update(jobs).where(running).values({"cancelling": True} | _CHANGED))
        job = self.get(tenant, job_id)
        if job is not None and job.state == State.CANCELLED and not job.started_at:
            try:
                self.client().cancel_workflow(job_id)
            except Exception as error:  # a worker takes it, and finds nothing to do
                _log.warning("job %s stays in the queue: %s", job_id, error)
            self._advance(tenant)
        return job

    def recover(self, silent_seconds: float, but: str = "") -> Sequence[str]:
        """Take over the jobs of workers that were silent for that long; ids of those workers.

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
        """Put jobs back in the queue. They continue at their last finished step; DBOS lets one who lost a job record no
        further step of it."""
        if job_ids:
            _log.warning("taken over: jobs %s", ", ".join(job_ids))
            self.client().resume_workflows(list(job_ids), queue_name=QUEUE)

    def reconcile(self) -> None:
        """Repair after a crash between two databases: jobs never enqueued, and jobs that ended without saying so."""
        turn = sa.func.row_number().over(partition_by=[jobs.c.tenant, jobs.c.state], order_by=_ORDER).label("turn")
        known = sa.select(jobs.c.id, jobs.c.state, jobs.c.created_at, turn).where(_OPEN).subquery()
        due = (known.c.state == State.RUNNING.value) | (known.c.turn == 1)  # at work, or the next of its tenant
        settled = known.c.created_at < ago(_SETTLED_HOURS)
        waiting = self._db.query(sa.select(known.c.id).where(due & settled)).scalars().all()
        for start in range(0, len(waiting), _PAGE):
            ids = waiting[start : start + _PAGE]
            found = self.client().list_workflows(workflow_ids=list(ids), load_input=False, load_output=False)
            status = {workflow.workflow_id: workflow.status for workflow in found}
            for job_id in ids:
                if job_id not in status:
                    self._enqueue(job_id)
                elif status[job_id] not in ("ENQUEUED", "PENDING", "DELAYED"):
                    _log.error("job %s ended as %s and said nothing", job_id, status[job_id])
                    problem = Problem("internal", "the work ended without a result")
                    self.result(job_id, State.FAILED, problem.to_json())

    def prune(self, hours: float) -> int:
        """Forget jobs that ended so long ago, here and in the engine's tables; how many. A dispute's finding is in its
        row: these stay."""
        ended = sa.not_(_OPEN) & (jobs.c.finished_at < ago(hours)) & (jobs.c.kind != "dispute")
        old = self._db.query(sa.select(jobs.c.id).where(ended)).scalars().all()
        for start in range(0, len(old), _PAGE):
            ids = list(old[start : start + _PAGE])
            self.client().delete_workflows(ids)
            self._db.change(sa.delete(jobs).where(jobs.c.id.in_(ids)))
        return len(old)

    def close(self) -> None:
        """Give connections back."""
        with self._lock:
            if self._opened is not None:
                self._opened.destroy()
                self._opened = None

    def client(self) -> DBOSClient:
        """DBOS for a process that runs no job. Opened on first use: the library takes most of a second to import."""
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
        mine = jobs.c.tenant == tenant
        at_work = sa.select(sa.func.count()).select_from(jobs).where(mine & _RUNNING).scalar_subquery()
        oldest = sa.select(jobs.c.id, jobs.c.created_at, at_work.label("at_work")).where(mine & _QUEUED)
        try:
            if (found := self._db.query(oldest.order_by(*_ORDER).limit(1)).first()) is not None:
                self._enqueue(found.id, found.at_work, seconds_until(found.created_at))
        except Exception as error:  # the row is what counts: `reconcile` makes up for it
            _log.warning("the next job of tenant %s is enqueued later: %s", tenant, error)

    def _enqueue(self, job_id: str, at_work: int = 0, seconds: float = 0.0) -> None:
        """Once for each id, to be begun in so many seconds; jobs of one priority run in their order of coming."""
        options: Any = {"workflow_name": WORKFLOW, "queue_name": QUEUE, "workflow_id": job_id, "priority": 1 + at_work}
        if seconds > 0:
            options["delay_seconds"] = seconds
        self.client().enqueue(options, job_id)


def too_many(most: int) -> Problem:
    """The error where a tenant has that many jobs."""
    text = f"{most} jobs of this tenant are waiting or running: send more when some have ended"
    return Problem("budget-exceeded", text, headers={"Retry-After": "30"})


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


def announce(connection: sa.Connection, event: str, tenant: str | sa.ScalarSelect[str], about: str) -> None:
    """Add a message about a job or a notice to those of the tenant's webhooks that listen to this event."""
    pending = sa.select(webhooks.c.id, sa.literal(about), sa.literal(now()), sa.literal(0))
    pending = pending.where(webhooks.c.tenant == tenant, webhooks.c.events.contains(event))
    connection.execute(deliveries.insert().from_select(["webhook", "job", "due_at", "tries"], pending))


def _waiting(tenant: str) -> sa.Select[int]:
    return sa.select(sa.func.count()).select_from(jobs).where((jobs.c.tenant == tenant) & _OPEN)


def _mine(tenant: str, job_id: str) -> sa.ColumnElement[bool]:
    return (jobs.c.tenant == tenant) & (jobs.c.id == job_id)


def job_of(row: sa.Row[Any]) -> Job:
    """The job that a row of the table says."""
    plain = {each.name: getattr(row, each.name) for each in fields(Job)}
    parsed = {name: plain[name] and json.loads(plain[name]) for name in ("request", "result", "problem")}
    dates = {name: plain[name] or "" for name in ("started_at", "finished_at")}
    return Job(**plain | parsed | dates | {"state": State(row.state)})
