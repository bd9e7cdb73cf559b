"""Seconds of `auto` beside those of the named profiles: none pays for coming first."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from engine.flows.embed.profiles import Auto, EmbedConfig
from engine.lab.evaluate.bench import marking
from tests.scenes import PLANT


def test_who_comes_first_pays_for_the_memory_but_not_in_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each profile is timed early and late, and the least counts."""
    order: list[Any] = []

    def embed(*_: object, config: EmbedConfig | Auto, **__: object) -> SimpleNamespace:
        order.append(config)
        return SimpleNamespace(report=Report())

    class Report(dict[str, float]):
        choice = None

        def __missing__(self, _: str) -> float:
            return 0.0

    def clock() -> Iterator[float]:
        now = 0.0
        for took in (9.0, 2.0, 4.0, 5.0, 3.0, 1.0):
            yield now
            yield now + took
            now += 100.0

    ticks = clock()
    monkeypatch.setattr(marking, "embed", embed)
    monkeypatch.setattr(marking, "time", SimpleNamespace(process_time=lambda: next(ticks)))
    rows = marking.measure_promises(str(PLANT), 1)
    assert {row["profile"]: row["cpu_seconds"] for row in rows} == {"auto": 1.0, "fast": 2.0, "balanced": 4.0}
    assert order[1:4] == order[:3:-1]
