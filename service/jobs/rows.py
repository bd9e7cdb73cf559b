"""The `jobs` table: what people see of a job. Every change is one conditional statement; a final job never changes.

DBOS knows a workflow as queued, pending or ended, and learns of a step once it is over. What happens within a step is
here: how far it is, that it is to stop, that another worker has the job by now, and how many workers it has cost. So is
a job's end, since the messages to webhooks are written by the same transaction.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from service.clock import now
from service.db import Database, page
from service.db.schema import deliveries, jobs, webhooks
from service.jobs.port import FINAL, Job, State

_OPEN = jobs.c.state.not_in([state.value for state in FINAL])
_QUEUED = jobs.c.state == State.QUEUED.value
_RUNNING = jobs.c.state == State.RUNNING.value
_ORDER = (jobs.c.created_at, jobs.c.id)
_CHANGED: dict[str, object] = {"revision": jobs.c.revision + 1}


class Rows:
    """Reads and changes of the table."""

    def __init__(self, db: Database) -> None:
        self._db = db

    def add(self, job: Job) -> Job | None:
        """A new queued job, or the one that has this id; None where another tenant's has."""
        values = {name: getattr(job, name) for name in ("id", "tenant", "api_key", "kind")}
        values |= {"state": State.QUEUED.value, "stage": "", "created_at": job.created_at or now()}
        try:
            with self._db.write() as connection:
                connection.execute(jobs.insert().values(**values, request=dumps(job.request)))
        except IntegrityError:
            pass  # the id is taken: the same job sent again
        return self.get(job.tenant, job.id)

    def get(self, tenant: str, job_id: str) -> Job | None:
        """A tenant's job."""
        with self._db.read() as connection:
            row = connection.execute(sa.select(jobs).where(_mine(tenant, job_id))).first()
        return None if row is None else job_of(row)

    def list(
        self, tenant: str, limit: int = 20, after: str = "", states: Collection[str] = (), kind: str = ""
    ) -> Sequence[Job]:
        """Jobs of a tenant, newest first, after the job with this id; those in these states, and of this kind."""
        where = sa.and_(jobs.c.state.in_(states or list(State)), jobs.c.kind == kind if kind else sa.true())
        with self._db.read() as connection:
            return [job_of(row) for row in page(connection, jobs, tenant, limit, after, where=where)[0]]

    def positions(self, asked: Sequence[Job]) -> dict[str, int]:
        """Places in the queue of those jobs that wait, by id: 1 is begun next, as things stand.

        Of all tenants' jobs, as they take turns: the first job of each tenant before the second of any, a tenant with
        jobs at work so many turns later, equals in their order of coming. Who comes later and has fewer goes first.
        """
        waiting = [job.id for job in asked if job.state is State.QUEUED]
        if not waiting:
            return {}
        # Those at work come first in this numbering of a tenant's jobs: its first job that waits has so many before it.
        first = (jobs.c.state != State.RUNNING.value, *_ORDER)
        turn = sa.func.row_number().over(partition_by=jobs.c.tenant, order_by=first).label("turn")
        known = sa.select(*_ORDER, jobs.c.state, turn).where(_OPEN).subquery()
        queue = sa.select(known).where(known.c.state == State.QUEUED.value).subquery()
        place = sa.func.row_number().over(order_by=(queue.c.turn, queue.c.created_at, queue.c.id)).label("place")
        places = sa.select(queue.c.id, place).subquery()
        with self._db.read() as connection:
            found = connection.execute(sa.select(places).where(places.c.id.in_(waiting)))
            return {row.id: row.place for row in found}

    def cancel(self, tenant: str, job_id: str) -> Job | None:
        """A queued job is cancelled at once; a running one is asked to stop."""
        mine = _mine(tenant, job_id)
        queued = mine & _QUEUED
        running = mine & _RUNNING & sa.not_(jobs.c.cancelling)
        ended = {"state": State.CANCELLED.value, "cancelling": True, "finished_at": now()}
        with self._db.write() as connection:
            if connection.execute(sa.update(jobs).where(queued).values(ended | _CHANGED)).rowcount:
                _announce(connection, job_id)
            connection.execute(sa.update(jobs).where(running).values({"cancelling": True} | _CHANGED))
        return self.get(tenant, job_id)

    def begin(self, job_id: str, worker: str) -> Job | None:
        """A worker starts on a job, for the first time or again; None where there is nothing left to do."""
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
            return job_of(connection.execute(sa.select(jobs).where(this)).one())

    def progress(self, job_id: str, stage: str, fraction: float, attempt: int | None = None) -> bool:
        """Say how far a job is. False: cancellation was asked for (or the job is gone, or another's); stop."""
        held = jobs.c.attempts == attempt if attempt is not None else sa.true()
        going_on = (jobs.c.id == job_id) & held & _RUNNING & sa.not_(jobs.c.cancelling)
        with self._db.read() as connection:
            row = connection.execute(sa.select(jobs.c.stage, jobs.c.fraction).where(going_on)).first()
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
            ended |= {"result": dumps(value), "fraction": 1.0}
        elif state == State.FAILED:
            ended |= {"problem": dumps(value)}
        with self._db.write() as connection:
            this = (jobs.c.id == job_id) & _OPEN
            if connection.execute(sa.update(jobs).where(this).values(ended | _CHANGED)).rowcount:
                _announce(connection, job_id)

    def settled(self, job: Job) -> None:
        """A step of a job, as it was begun, is done: what is tried next is another."""
        held = (jobs.c.id == job.id) & (jobs.c.attempts == job.attempts)
        with self._db.write() as connection:
            connection.execute(sa.update(jobs).where(held).values(tries=1))

    def handed_back(self, worker: str) -> None:
        """A worker shuts down: that is no fault of the jobs it was at."""
        its = (jobs.c.worker == worker) & _RUNNING & (jobs.c.tries > 0)
        with self._db.write() as connection:
            connection.execute(sa.update(jobs).where(its).values(tries=jobs.c.tries - 1))

    def waiting(self, tenant: str) -> int:
        """How many jobs of a tenant are not final."""
        mine = sa.select(sa.func.count()).select_from(jobs).where((jobs.c.tenant == tenant) & _OPEN)
        with self._db.read() as connection:
            return int(connection.execute(mine).scalar_one())

    def next_of(self, tenant: str) -> tuple[str, int] | None:
        """Id of the tenant's queued job that was asked for first, and how many of its jobs are at work."""
        at_work = sa.select(sa.func.count()).select_from(jobs).where((jobs.c.tenant == tenant) & _RUNNING)
        queued = sa.select(jobs.c.id, at_work.scalar_subquery().label("at_work"))
        with self._db.read() as connection:
            mine = queued.where((jobs.c.tenant == tenant) & _QUEUED).order_by(*_ORDER).limit(1)
            found = connection.execute(mine).first()
        return None if found is None else (found.id, found.at_work)

    def due_before(self, time: str) -> Sequence[str]:
        """Ids of jobs that were asked for before that time and are at work, or the next of their tenant."""
        turn = sa.func.row_number().over(partition_by=[jobs.c.tenant, jobs.c.state], order_by=_ORDER).label("turn")
        known = sa.select(jobs.c.id, jobs.c.state, jobs.c.created_at, turn).where(_OPEN).subquery()
        due = (known.c.created_at < time) & ((known.c.state == State.RUNNING.value) | (known.c.turn == 1))
        with self._db.read() as connection:
            return connection.execute(sa.select(known.c.id).where(due)).scalars().all()

    def ended_before(self, time: str) -> Sequence[str]:
        """Ids of jobs that ended before that time. A dispute's finding is in its row: these stay."""
        old = sa.not_(_OPEN) & (jobs.c.finished_at < time) & (jobs.c.kind != "dispute")
        with self._db.read() as connection:
            return connection.execute(sa.select(jobs.c.id).where(old)).scalars().all()


def dumps(value: Mapping[str, Any]) -> str:
    """JSON in canonical form."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


def _announce(connection: sa.Connection, job_id: str) -> None:
    """What the end of a job, in its own transaction, adds to the messages of its tenant's webhooks."""
    told = sa.select(webhooks.c.id, jobs.c.id, sa.literal(now()), sa.literal(0))
    told = told.join_from(webhooks, jobs, webhooks.c.tenant == jobs.c.tenant).where(jobs.c.id == job_id)
    connection.execute(deliveries.insert().from_select(["webhook", "job", "due_at", "tries"], told))


def _mine(tenant: str, job_id: str) -> sa.ColumnElement[bool]:
    return (jobs.c.tenant == tenant) & (jobs.c.id == job_id)


def job_of(row: sa.Row[Any]) -> Job:
    """The job that a row of the table says."""
    plain = {each.name: getattr(row, each.name) for each in fields(Job)}
    parsed = {name: plain[name] and json.loads(plain[name]) for name in ("request", "result", "problem")}
    dates = {name: plain[name] or "" for name in ("started_at", "finished_at")}
    return Job(**plain | parsed | dates | {"state": State(row.state)})
