"""Budgets: never more than the limit in any span of time, wherever the clock's hours and days begin."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Thread

import pytest
import sqlalchemy as sa

from service.db import Database
from service.db.schema import usage
from service.http import budgets
from service.problems import Problem
from service.settings import Settings

MIDNIGHT = datetime(2026, 3, 1, tzinfo=UTC)
LIMIT = 4


@pytest.fixture
def db(tmp_path: Path) -> Database:
    made = Database(f"sqlite:///{tmp_path / 'test.sqlite'}")
    made.migrate()
    return made


class Clock:
    """The time as budgets see it."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.moment = MIDNIGHT
        patch.setattr(budgets, "_now", lambda: self.moment)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def spend(db: Database, hours: int = 24, subject: str = "one") -> int | None:
    """None, or the seconds after which to try again."""
    try:
        budgets.spend(db, subject, LIMIT, hours, "questions")
    except Problem as problem:
        return int(problem.headers["Retry-After"])
    return None


@pytest.mark.parametrize("late", [0.0, 0.8])
@pytest.mark.parametrize("hours", [1, 24])
def test_no_span_of_time_holds_more_than_the_limit(db: Database, clock: Clock, hours: int, late: float) -> None:
    """Somebody who asks all the time, around every hour and day, first at the begin or the end of a part."""
    span, passed = timedelta(hours=hours), []
    begin = MIDNIGHT - span + late * span / budgets.PARTS
    for step in range(250):
        clock.moment = begin + step * span / 77
        if spend(db, hours) is None:
            passed.append(clock.moment)
    for first, later in zip(passed, passed[LIMIT:], strict=False):
        assert later - first >= span
    assert len(passed) >= 3 * LIMIT


def test_a_day_that_ends_gives_nothing_back(db: Database, clock: Clock) -> None:
    clock.moment = MIDNIGHT - timedelta(seconds=2)
    assert [spend(db) for _ in range(LIMIT)] == [None] * LIMIT
    clock.moment = MIDNIGHT + timedelta(seconds=2)
    assert spend(db) is not None
    assert spend(db, subject="another") is None


@pytest.mark.parametrize("hours", [1, 24])
def test_who_waits_as_told_may_ask_again(db: Database, clock: Clock, hours: int) -> None:
    for minutes in (0, 20, 20, 20):
        clock.moment += timedelta(minutes=minutes * hours / 24, seconds=7)
        assert spend(db, hours) is None
    left = spend(db, hours)
    assert left is not None
    clock.moment += timedelta(seconds=left - 2)
    assert spend(db, hours) == 2
    clock.moment += timedelta(seconds=2)
    assert spend(db, hours) is None


def test_counts_of_an_earlier_version(db: Database, clock: Clock) -> None:
    """It counted by the day and by the hour."""
    with db.write() as connection:
        connection.execute(usage.insert().values(subject="one", window="2026-03-01T00+00:00/24", count=LIMIT))
    clock.moment += timedelta(hours=20)
    left = spend(db)
    assert left is not None
    assert 4 * 3600 <= left <= 5 * 3600 + 1


def test_counts_long_past_are_dropped(db: Database, clock: Clock) -> None:
    spend(db)
    clock.moment += timedelta(hours=47)
    spend(db)
    for hours, left in ((0, 2), (2, 1)):
        clock.moment += timedelta(hours=hours)
        budgets.forget(db)
        with db.read() as connection:
            assert connection.execute(sa.select(sa.func.count()).select_from(usage)).scalar_one() == left


@pytest.mark.parametrize("kind", ["sqlite", "postgres"])
def test_many_at_once_share_it(kind: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    url = f"sqlite:///{tmp_path / 'test.sqlite'}"
    if kind == "postgres":
        url = Settings(database_url=request.getfixturevalue("postgres").new_database("budgets")).database()
    database, answers = Database(url), []
    database.migrate()
    askers = [Thread(target=lambda: answers.append(spend(database))) for _ in range(4 * LIMIT)]
    for asker in askers:
        asker.start()
    for asker in askers:
        asker.join()
    assert answers.count(None) == LIMIT
    assert len(answers) == 4 * LIMIT
    database.close()
