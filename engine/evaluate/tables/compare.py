"""Settings side by side: each against a base, paired by scene, key and view, so that only the setting differs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from engine.evaluate.intervals import bootstrap
from engine.evaluate.study import Row
from engine.evaluate.tables.part import of_kind

__all__ = ["CONDITIONS", "Effect", "effect", "paired"]

CONDITIONS = ("none", "JPEG 10", "noise 0.1")
"""What the pictures of a sweep went through."""


@dataclass(frozen=True)
class Effect:
    """Change of z against the base, in per cent, with a bootstrap interval over the pairs."""

    percent: float
    low: float
    high: float
    pairs: int

    @property
    def is_clear(self) -> bool:
        """Whether the interval leaves out no change at all."""
        return self.low > 0.0 or self.high < 0.0

    def __str__(self) -> str:
        return f"{self.percent:+.1f} % ({self.low:+.1f} to {self.high:+.1f})"


def effect(rows: Sequence[Row], setting: str, base: str, condition: str) -> Effect | None:
    """Of a setting on z: of pictures after an attack, or of the model itself for ``"model"``; None without pairs."""
    ratios = paired(rows, setting, base, condition)
    if not ratios:
        return None
    logs = [math.log(ratio) for ratio in ratios]
    mean, (low, high) = sum(logs) / len(logs), bootstrap(logs)
    percent, low, high = (100.0 * math.expm1(value) for value in (mean, low, high))
    return Effect(percent, low, high, len(logs))


def paired(rows: Sequence[Row], setting: str, base: str, condition: str) -> list[float]:
    """Ratios of z, setting over base, of readings that differ in nothing else; where either is no evidence, none."""
    mine, its = (_by_place(rows, name, condition) for name in (setting, base))
    return [mine[place] / its[place] for place in mine if place in its and min(mine[place], its[place]) > 0.0]


def _by_place(rows: Sequence[Row], setting: str, condition: str) -> dict[tuple[object, ...], float]:
    wanted = {"kind": "marked"} if condition == "model" else {"kind": "picture", "attack": condition}
    found = of_kind(rows, setting=setting, **wanted)
    return {(row["scene"], row["seed"], row.get("view")): float(row["z"]) for row in found}
