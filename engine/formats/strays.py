"""Gaussians far away from all others. Formats that share one range among many rows would lose the others to them."""

import numpy as np

from engine.formats.repairs import VISIBLE_ROUNDING
from engine.formats.spz.attributes import choose_fractional_bits
from engine.model import Bool, Float32, Float64, GaussianModel

__all__ = ["stray_rows", "unheld_rows"]

STRAY_SHARE = 0.002
"""Of all Gaussians, at most: more of them are a part of the scene. Twice the thousandth that trainers leave behind."""

STRAY_DISTANCE = 64.0
"""Times the extent of all others. In real scenes with their sky the outermost lie within 3 times."""


def stray_rows(means: Float32) -> Bool:
    """(N,) which of the centers (N, 3) are strays: few, and beyond `STRAY_DISTANCE` times the extent of the others."""
    points = means.astype(np.float64)
    distance = np.abs(points - np.median(points, axis=0)).max(axis=1)
    kth = int((1 - STRAY_SHARE) * (len(distance) - 1))
    extent = np.partition(distance, kth)[kth]
    return np.asarray((distance > STRAY_DISTANCE * extent) & (extent > 0))


def unheld_rows(model: GaussianModel, format: str) -> Bool:
    """(N,) the strays that a format cannot hold without rounding the others by more than `VISIBLE_ROUNDING`."""
    strays = stray_rows(model.means) if format in _STEPS else np.zeros(len(model), dtype=np.bool_)
    if strays.any():
        size = float(np.exp(np.median(model.log_scales[~strays].astype(np.float64).mean(axis=1))))
        if _STEPS[format](model.means.astype(np.float64)) / 2 <= VISIBLE_ROUNDING * size:
            strays[:] = False
    return strays


def _spz_step(means: Float64) -> float:
    return 2.0 ** -choose_fractional_bits(means.astype(np.float32))


def _sog_step(means: Float64) -> float:
    """At the median center, on the axis of the widest range; see `engine.formats.sog.encoding.position_codes`."""
    bent = np.sign(means) * np.log1p(np.abs(means))
    steps = np.ptp(bent, axis=0) / 65535 * (1 + np.abs(np.median(means, axis=0)))
    return float(steps.max())


def _chunk_step(means: Float64) -> float:
    """Of the chunk of a compressed PLY that holds the stray."""
    return float(np.ptp(means, axis=0).max()) / 2047


_STEPS = {"spz": _spz_step, "sog": _sog_step, "compressed.ply": _chunk_step}
"""Step of the centers, scene units, of the formats that have one range for many."""
