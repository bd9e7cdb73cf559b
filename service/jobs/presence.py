"""Which workers are alive: each writes a row every few seconds, and each watches the others' rows.

DBOS recovers the jobs of an executor when a process starts under that executor's name. That another one died is noticed
by its hosted console alone.
"""

import os
import socket
import time
from collections.abc import Collection

import sqlalchemy as sa

from service.clock import now
from service.db import Database
from service.db.schema import workers

LEFT = 0.0
"""`seen_at` of a worker that shut down: its jobs can be taken over at once."""


class Presence:
    """The `workers` table, and since when this process has seen no change in each row.

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
