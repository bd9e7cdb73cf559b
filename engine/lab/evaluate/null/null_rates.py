"""How often unrelated keys reach which score, against what the theorem allows them."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.null.wrong_keys import wrong_key_z
from engine.lab.evaluate.study import Row
from engine.model import Float64
from engine.watermark.statistics import z_threshold

__all__ = [
    "CLAIM",
    "LOG10_THRESHOLDS",
    "Rates",
    "above",
    "add_up",
    "count_wrong_keys",
    "counted",
    "exceeding",
    "share_claimed",
]

LOG10_THRESHOLDS = tuple(-0.25 * k for k in range(1, 37))
"""Stated bounds at which claims are counted: 10^-0.25 to 10^-9."""
CLAIM = LOG10_THRESHOLDS[-1]


@dataclass(frozen=True, eq=False)
class Rates:
    """How many of some keys have a stated bound at or below each of `LOG10_THRESHOLDS`."""

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


def above(z: Float64 | Sequence[float]) -> list[int]:
    """How many values have a stated bound exp(-z^2 / 2) at or below each of `LOG10_THRESHOLDS`."""
    return [int(np.count_nonzero(np.asarray(z) >= z_threshold(10.0**log10))) for log10 in LOG10_THRESHOLDS]


def share_claimed(z: Sequence[float], log10_bound: float) -> float:
    """Share of values whose stated bound exp(-z^2 / 2) is at or below 10^log10_bound."""
    return float(np.mean(np.asarray(z) >= z_threshold(10.0**log10_bound)))


def count_wrong_keys(y: Float64, weights: Float64, keys: int, *stream: object) -> Row:
    """`counted` Z of wrong keys on one evidence (y, weights: (C,)); `stream` names what they are tried on."""
    return counted(wrong_key_z(y, weights, hashlib.sha256(repr(stream).encode()).digest(), keys))


def counted(z: Float64) -> Row:
    """Values of keys without a part as counts at each of `LOG10_THRESHOLDS`, and how they are spread."""
    spread = {"z_largest": float(z.max()), "z_mean": float(z.mean()), "z_std": float(z.std())}
    return {"keys": len(z), "hits": above(z), **spread}


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
