"""The null distribution: Z of unrelated keys, and how often they reach which score, against what the theorem allows."""

# mypy: allow-untyped-defs

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.kernels.jit import parallel_kernel, share_of
from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.study import Row
from engine.model import Float64
from engine.watermark.keys import SUBKEY_BYTES, keystream
from engine.watermark.statistics import weighted_evidence, z_threshold

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
    "wrong_key_z",
]

_BATCH, _MOST = 1 << 15, 1 << 28  # keys at a time; and bytes of their keystream
_BLOCK = 2048  # keys whose sums stay in the fastest cache


def wrong_key_z(y: Float64, w: Float64, seed: bytes, count: int) -> Float64:
    """(count,) Z of keys unrelated to the evidence: samples of the null distribution, given y and w.

    The message and the dealing of bits only flip signs that are fair anyway, so neither is needed. Eight
    chips at a time become one byte of keystream and one look-up of their 256 possible sums: a million keys of
    690,000 chips take about two and a half minutes of one core.

    Parameters
    ----------
    y, w : (C,)
    seed : bytes
        32 bytes; the same seed gives the same keys.
    """
    if len(seed) != SUBKEY_BYTES:
        raise ValueError(f"seed must have {SUBKEY_BYTES} bytes, got {len(seed)}")
    c = weighted_evidence(y, w)
    norm = math.sqrt(float(c @ c))
    if norm == 0:
        return np.zeros(count)
    c = np.pad(c / norm, (0, -len(c) % 8)).reshape(-1, 8)  # (C/8, 8)
    patterns = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1, bitorder="little")
    sums = c @ (2.0 * patterns.T - 1.0)  # (C/8, 256) every byte's signed sum
    z, batch = np.zeros(count), max(1, min(_BATCH, _MOST // len(sums)))
    for number, start in enumerate(range(0, count, batch)):
        part = z[start : start + batch]
        stream = keystream(seed, len(sums) * len(part), f"null{number}").reshape(len(sums), len(part))
        _look_up(sums, stream, part, _BLOCK)
    return z


@parallel_kernel
def _look_up(sums, stream, z, block, call):
    """Add to `z` (K,) of each row of `stream` (R, K) of bytes the sums (R, 256) that they name, four rows at a time."""
    rows = len(sums) - len(sums) % 4
    for piece in share_of((len(z) + block - 1) // block, call):
        start, end = piece * block, min((piece + 1) * block, len(z))
        for r in range(0, rows, 4):
            for k in range(start, end):
                first = sums[r, stream[r, k]] + sums[r + 1, stream[r + 1, k]]
                z[k] += first + sums[r + 2, stream[r + 2, k]] + sums[r + 3, stream[r + 3, k]]
        for r in range(rows, len(sums)):
            for k in range(start, end):
                z[k] += sums[r, stream[r, k]]


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
