"""Gaussians far away from all others. Formats that share one range among many rows would lose the others to them."""

import numpy as np

from engine.formats.declaration import Kind
from engine.formats.repairs import VISIBLE_ROUNDING
from engine.model import Bool, Float32, GaussianModel

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


def unheld_rows(model: GaussianModel, kind: Kind) -> Bool:
    """(N,) the strays that a format cannot hold without rounding the others by more than `VISIBLE_ROUNDING`."""
    strays = stray_rows(model.means) if kind.step else np.zeros(len(model), dtype=np.bool_)
    if kind.step and strays.any():
        size = float(np.exp(np.median(model.log_scales[~strays].astype(np.float64).mean(axis=1))))
        if kind.step(model.means.astype(np.float64)) / 2 <= VISIBLE_ROUNDING * size:
            strays[:] = False
    return strays
