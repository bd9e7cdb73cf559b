"""How silence is measured."""

from __future__ import annotations

from service.jobs.presence import LEFT, Watch
from tests.service.jobs.conftest import Clock


def test_silence_counts_from_when_it_was_first_seen(clock: Clock) -> None:
    watch = Watch()
    long_ago = {"w": 5.0}  # another machine's clock may say anything
    assert watch.silent(long_ago, (), 10) == []
    clock.now += 9
    assert watch.silent(long_ago, (), 10) == []
    clock.now += 1
    assert watch.silent(long_ago, (), 10) == ["w"]


def test_a_sign_of_life_starts_over(clock: Clock) -> None:
    watch = Watch()
    for beat in range(5):
        assert watch.silent({"w": 100.0 + beat}, (), 10) == []
        clock.now += 9


def test_a_worker_without_a_row_that_holds_jobs_is_silent_too(clock: Clock) -> None:
    watch = Watch()
    assert watch.silent({}, {"lost"}, 10) == []
    clock.now += 10
    assert watch.silent({"well": 3.0}, {"lost", "well"}, 10) == ["lost"]


def test_time_in_which_nobody_could_write_does_not_count(clock: Clock) -> None:
    watch = Watch()
    watch.silent({"w": 5.0}, (), 10)
    clock.now += 60
    watch.start_over()
    assert watch.silent({"w": 5.0}, (), 10) == []


def test_who_left_is_silent_at_once(clock: Clock) -> None:
    assert Watch().silent({"w": LEFT}, {"w"}, 10) == ["w"]
