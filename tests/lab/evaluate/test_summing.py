"""Timings of a busy machine are called what they are."""

from __future__ import annotations

from engine.lab.evaluate.machine import load_per_core
from engine.lab.evaluate.summary import busy_words


def test_words_only_where_they_are_due() -> None:
    assert busy_words([]) == []
    assert busy_words([{"busy": 1.1}, {"busy": None}, {}]) == []
    assert "4.2 programs a core" in busy_words([{"busy": 0.5}, {"busy": 4.2}])[0]


def test_the_load_is_not_negative() -> None:
    load = load_per_core()
    assert load is None or load >= 0.0
