"""Budgets: how often a subject may do something within one window of time."""

from datetime import UTC, datetime, timedelta

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from service.db import Database
from service.db.schema import usage
from service.problems import Problem


def spend(db: Database, subject: str, limit: int, hours: int, what: str) -> None:
    """Count one use; budget-exceeded with Retry-After, once `limit` uses fell into the present window."""
    window, left = _window(hours)
    insert = (sqlite.insert if db.is_sqlite else postgresql.insert)(usage)
    statement = insert.values(subject=subject, window=window, count=1).on_conflict_do_update(
        index_elements=["subject", "window"], set_={"count": usage.c.count + 1}, where=usage.c.count < limit
    )
    with db.write() as connection:
        if connection.execute(statement).rowcount == 0:
            text = f"{what}: at most {limit} in {hours} h"
            raise Problem("budget-exceeded", text, headers={"Retry-After": str(left)})


def forget(db: Database) -> None:
    """Drop the counts of windows long past."""
    limit = (datetime.now(UTC) - timedelta(days=2)).isoformat(timespec="hours")
    with db.write() as connection:
        connection.execute(sa.delete(usage).where(usage.c.window < limit))


def _window(hours: int) -> tuple[str, int]:
    """Name of the present window, and seconds until the next."""
    moment = datetime.now(UTC)
    began = moment.replace(minute=0, second=0, microsecond=0)
    began -= timedelta(hours=began.hour % hours)
    left = began + timedelta(hours=hours) - moment
    return f"{began.isoformat(timespec='hours')}/{hours}", int(left.total_seconds()) + 1
