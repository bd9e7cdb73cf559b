"""Counts of all wrong keys, added up, beside the bound."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.evaluate.intervals import share_interval
from engine.evaluate.null.counting import LOG10_THRESHOLDS
from engine.evaluate.study import Row
from engine.model import Float64

__all__ = ["Rates", "add_up", "exceeding", "share_claimed"]


@dataclass(frozen=True, eq=False)
class Rates:
    """Shares of keys whose stated bound is at or below each of `LOG10_THRESHOLDS`.

    Parameters
    ----------
    hits : tuple of int
    """

    name: str
    keys: int
    hits: tuple[int, ...]

    @property
    def shares(self) -> Float64:
        """(L,) measured."""
        return np.array(self.hits) / max(self.keys, 1)

    @property
    def intervals(self) -> Float64:
        """(L, 2) exact, 95 %."""
        return np.array([share_interval(hits, self.keys) for hits in self.hits])


def add_up(rows: Sequence[Row], name: str) -> Rates:
    """All keys of several suspects together."""
    hits = np.sum([row["hits"] for row in rows], axis=0) if rows else np.zeros(len(LOG10_THRESHOLDS))
    return Rates(name, sum(row["keys"] for row in rows), tuple(int(count) for count in hits))


def exceeding(rates: Rates, confidence: float = 0.95) -> list[float]:
    """Bounds (log10) that a share exceeds beyond chance: its exact interval, all thresholds counted, lies above."""
    level = 1.0 - (1.0 - confidence) / len(LOG10_THRESHOLDS)
    return [
        log10
        for log10, hits in zip(LOG10_THRESHOLDS, rates.hits, strict=True)
        if share_interval(hits, rates.keys, level)[0] > 10.0**log10
    ]


def share_claimed(z: Sequence[float], log10_bound: float) -> float:
    """Share of values whose stated bound exp(-z^2 / 2) is at or below 10^log10_bound."""
    limit = math.sqrt(-2.0 * math.log(10.0) * log10_bound)
    return float(np.mean(np.asarray(z) >= limit))
