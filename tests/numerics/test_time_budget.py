from __future__ import annotations

from engine.numerics.time_budget import TimeBudget


class Hands:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.at = 100.0

    def __call__(self) -> float:
        return self.at


def test_steps_are_allowed_until_the_time_is_over_and_those_left_out_are_told_once() -> None:
    clock = Hands()
    budget = TimeBudget(10.0, clock)
    clock.at += 9.9
    assert budget.allows("first")
    assert budget.left_out == ()
    clock.at += 0.2
    assert not budget.allows("second")
    assert not budget.allows("third")
    assert not budget.allows("second")
    assert budget.left_out == ("second", "third")


def test_time_stands_still_while_it_rests() -> None:
    clock = Hands()
    budget = TimeBudget(10.0, clock)
    clock.at += 4.0
    budget.rest()
    clock.at += 1000.0
    budget.go_on()
    clock.at += 5.0
    assert budget.allows("within")
    clock.at += 2.0
    assert not budget.allows("beyond")


def test_without_a_limit_everything_is_allowed() -> None:
    clock = Hands()
    budget = TimeBudget(now=clock)
    clock.at += 1e12
    assert budget.allows("anything")
