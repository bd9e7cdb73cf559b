"""Slow, obviously right twin of engine.numerics.similarity: covariances and colours moved by definition."""

from __future__ import annotations

import numpy as np

from engine.model import GaussianModel
from tests.reference.spherical_harmonics import sh_colour


def covariance(model: GaussianModel, i: int) -> np.ndarray:
    """Covariance of Gaussian i in float64, by the textbook formula."""
    w, x, y, z = model.quats[i].astype(float) / np.linalg.norm(model.quats[i].astype(float))
    turn = np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )
    return turn @ np.diag(np.exp(2 * model.log_scales[i].astype(float))) @ turn.T


def moved_covariance(model: GaussianModel, i: int, scale: float, R: np.ndarray) -> np.ndarray:
    return scale**2 * R @ covariance(model, i) @ R.T


def moved_colour(model: GaussianModel, i: int, R: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Colour of the moved Gaussian: what the old one showed from the turned-back direction."""
    return sh_colour(model.sh[i].astype(float), R.T @ direction)
