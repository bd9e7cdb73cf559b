"""How often keys that had no part in a suspect come how far, against what the theorem allows them."""

import hashlib
import math
from collections.abc import Sequence

import numpy as np

from engine.evaluate.study import Row
from engine.model import Float64
from engine.watermark.statistics import wrong_key_z

__all__ = ["LOG10_THRESHOLDS", "above", "count_wrong_keys", "wrong_key_seed"]

LOG10_THRESHOLDS = tuple(-0.25 * k for k in range(1, 37))
"""Stated bounds at which claims are counted: 10^-0.25 to 10^-9."""


def wrong_key_seed(*parts: object) -> bytes:
    """32 bytes for the stream of wrong keys, different for each thing they are tried on."""
    return hashlib.sha256(repr(parts).encode()).digest()


def above(z: Float64 | Sequence[float]) -> list[int]:
    """How many values have a stated bound exp(-z^2 / 2) at or below each of `LOG10_THRESHOLDS`."""
    values = np.asarray(z, dtype=np.float64)
    limits = [math.sqrt(-2.0 * math.log(10.0) * log10) for log10 in LOG10_THRESHOLDS]
    return [int(np.count_nonzero(values >= limit)) for limit in limits]


def count_wrong_keys(y: Float64, weights: Float64, keys: int, seed: bytes) -> Row:
    """Z of wrong keys on one evidence, as counts.

    Parameters
    ----------
    y, weights : (C,) float64
    seed : bytes
        See `wrong_key_seed`.

    Returns
    -------
    dict
        keys, hits (at each of `LOG10_THRESHOLDS`), z_largest, z_mean, z_std.
    """
    z = wrong_key_z(y, weights, seed, keys)
    return {
        "keys": keys,
        "hits": above(z),
        "z_largest": float(z.max()),
        "z_mean": float(z.mean()),
        "z_std": float(z.std()),
    }
