"""Who is alive: workers write a row every few seconds, and watch each other's."""

import os
import socket
import time
from collections.abc import Collection, Mapping

import sqlalchemy as sa

from service.clock import now
from service.db import Database
from service.db.schema import workers

LEFT = 0.0
"""`seen_at` of a worker that shut down: its jobs can be taken over at once."""


class Presence:
    """The `workers` table."""

    def __init__(self, db: Database) -> None:
        self._db = db

    def beat(self, worker: str) -> None:
        """This worker lives."""
        seen = time.time()
        row = {"host": socket.gethostname(), "pid": os.getpid(), "seen_at": seen}
        with self._db.write() as connection:
            update = sa.update(workers).where(workers.c.id == worker).values(row)
            if not connection.execute(update).rowcount:
                connection.execute(workers.insert().values(row | {"id": worker, "started_at": now()}))

    def leave(self, worker: str) -> None:
        """This worker shuts down."""
        with self._db.write() as connection:
            connection.execute(sa.update(workers).where(workers.c.id == worker).values(seen_at=LEFT))

    def seen(self) -> dict[str, float]:
        """When each worker was last heard of."""
        with self._db.read() as connection:
            rows = connection.execute(sa.select(workers.c.id, workers.c.seen_at))
            return {row.id: row.seen_at for row in rows}

    def forget(self, worker: str, seen_at: float) -> bool:
        """Strike a worker off, unless it was heard of again; True for the one caller that did it."""
        this = (workers.c.id == worker) & (workers.c.seen_at == seen_at)
        with self._db.write() as connection:
            return connection.execute(sa.delete(workers).where(this)).rowcount > 0


class Watch:
    """Tells how long workers have been silent, by the clock of the one who watches.

    Clocks of several machines are never compared, and a time in which the database did not answer anybody counts
    for nobody.
    """

    def __init__(self) -> None:
        self._since: dict[str, tuple[float | None, float]] = {}

    def silent(self, seen: Mapping[str, float], owners: Collection[str], seconds: float) -> list[str]:
        """Workers that left, or have not changed their row for that long.

        `seen` is each worker's last sign of life, as just read; one that only holds jobs (`owners`), without a row, is
        as silent as can be.
        """
        moment = time.monotonic()
        signs: dict[str, float | None] = dict.fromkeys(owners) | dict(seen)
        self._since = {
            worker: old if (old := self._since.get(worker)) and old[0] == sign else (sign, moment)
            for worker, sign in signs.items()
        }
        return [worker for worker, (sign, since) in self._since.items() if sign == LEFT or moment - since >= seconds]

    def start_over(self) -> None:
        """Nothing could be seen for a while."""
        self._since.clear()
