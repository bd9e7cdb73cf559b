"""How silence is measured."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import sqlalchemy as sa

from service.db.schema import workers
from service.jobs.durable_jobs import DurableJobs, Presence
from service.settings import Settings
from tests.service.jobs.conftest import Clock, opened


@pytest.fixture
def jobs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DurableJobs]:
    with opened(Settings(data_dir=tmp_path_factory.mktemp("data"))) as engine:
        yield engine


@pytest.fixture
def presence(jobs: DurableJobs) -> Presence:
    return jobs.presence


def test_silence_counts_from_when_it_was_first_seen(jobs: DurableJobs, presence: Presence, clock: Clock) -> None:
    presence.beat("w")
    with jobs._db.write() as connection:  # another machine's clock may say anything
        connection.execute(sa.update(workers).values(seen_at=5.0))
    assert presence.silent((), 10) == []
    clock.now += 9
    assert presence.silent((), 10) == []
    clock.now += 1
    assert presence.silent((), 10) == ["w"]


def test_a_sign_of_life_starts_over(presence: Presence, clock: Clock) -> None:
    for _ in range(5):
        presence.beat("w")
        assert presence.silent((), 10) == []
        clock.now += 9


def test_a_worker_without_a_row_that_holds_jobs_is_silent_too(presence: Presence, clock: Clock) -> None:
    assert presence.silent({"lost"}, 10) == []
    clock.now += 10
    presence.beat("well")
    assert presence.silent({"lost", "well"}, 10) == ["lost"]
    assert presence.strike_off("lost")


def test_a_sign_of_life_comes_in_time_until_the_row_is_struck_off(presence: Presence, clock: Clock) -> None:
    presence.beat("w")
    presence.silent((), 10)
    clock.now += 10
    assert presence.silent((), 10) == ["w"]
    presence.beat("w")
    assert not presence.strike_off("w")


def test_one_of_two_strikes_a_worker_off(jobs: DurableJobs, presence: Presence, clock: Clock) -> None:
    other = Presence(jobs._db)
    presence.beat("w")
    for each in (presence, other):
        each.silent((), 10)
    clock.now += 10
    for each in (presence, other):
        assert each.silent((), 10) == ["w"]
    assert [each.strike_off("w") for each in (presence, other)] == [True, False]


def test_time_in_which_nobody_could_write_does_not_count(
    jobs: DurableJobs, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs.presence.beat("w")
    assert jobs.recover(10) == []
    clock.now += 60
    with monkeypatch.context() as outage:
        outage.setattr(jobs, "client", _away)
        with pytest.raises(ConnectionError):
            jobs.recover(10)
    assert jobs.recover(10) == []
    clock.now += 10
    assert jobs.recover(10) == ["w"]


def test_a_worker_does_not_judge_itself(jobs: DurableJobs, clock: Clock) -> None:
    """Its own signs of life may wait for a lock while it reads: its job must not begin a second time beside itself."""
    jobs.presence.beat("w")
    assert jobs.recover(10, "w") == []
    clock.now += 20
    assert jobs.recover(10, "w") == []
    assert jobs.recover(10) == ["w"]


def test_who_left_is_silent_at_once(presence: Presence) -> None:
    presence.beat("w")
    presence.leave("w")
    assert presence.silent({"w"}, 10) == ["w"]


def _away() -> None:
    raise ConnectionError
