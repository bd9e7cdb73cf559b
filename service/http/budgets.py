"""Budgets: how often a subject may do something within a span of time."""

from datetime import UTC, datetime, timedelta

import sqlalchemy as sa

from service.core import Service
from service.db import Database
from service.db.schema import usage
from service.problems import Problem

PARTS = 24
"""Uses are counted by parts of the span, so that it may end at any moment: counted by the day, twice as much as was
allowed went through around midnight."""


def spend(db: Database, subject: str, limit: int, hours: int, what: str) -> None:
    """Count one use; budget-exceeded with Retry-After where `limit` uses fell into the last `hours`.

    The part of which only the end lies within them counts whole: never are there more than `limit` in so long a time.
    """
    part = timedelta(hours=hours) / PARTS
    moment = _now()
    reach = timedelta(hours=hours) + part  # from when a part begins until it no longer counts
    present = moment - (moment - datetime.min.replace(tzinfo=UTC)) % part
    mine = usage.c.subject == subject
    counted = sa.select(sa.func.sum(usage.c.count), sa.func.min(usage.c.window))
    with db.exclusive() as connection:
        used, oldest = connection.execute(counted.where(mine & (usage.c.window > _name(moment - reach)))).one()
        if (used or 0) >= limit:
            began = oldest.partition("/")[0]  # counted by the day or the hour, it had "/24" or "/1" behind
            left = datetime.fromisoformat(began) + reach - moment
            text = f"{what}: at most {limit} in {hours} h"
            raise Problem("budget-exceeded", text, headers={"Retry-After": str(int(left.total_seconds()) + 1)})
        here = mine & (usage.c.window == _name(present))
        more = sa.update(usage).where(here).values(count=usage.c.count + 1)
        if connection.execute(more).rowcount == 0:
            connection.execute(sa.insert(usage).values(subject=subject, window=_name(present), count=1))


def spend_subject(service: Service, tenant: str, original: str, what: str) -> None:
    """Count one question about what derives from an original: all such suspects are near duplicates, and a detector
    queried often enough with slight changes of one model tells how to remove its mark. All copies of one original share
    the layer that is read, and so a budget."""
    spend(service.db, f"subject:{tenant}:{original}", service.settings.subject_verifies_per_day, 24, what)


def forget(db: Database) -> None:
    """Drop counts that are out of date."""
    db.change(sa.delete(usage).where(usage.c.window < _name(_now() - timedelta(days=2))))


def _now() -> datetime:
    return datetime.now(UTC)


def _name(moment: datetime) -> str:
    """Of the part that begins then: in the order of time."""
    return moment.isoformat(timespec="seconds")
