"""Slow, obviously right twin of engine.lab.sim.physics.deforming: Eq 12 one Gaussian at a time, by definition."""

from __future__ import annotations

import numpy as np
from scipy.linalg import polar

from engine.model import GaussianModel
from tests.reference.similarity import covariance
from tests.reference.spherical_harmonics import sh_colour


def deformed_covariance(model: GaussianModel, i: int, F: np.ndarray) -> np.ndarray:
    return F @ covariance(model, i) @ F.T


def nearest_rotation(F: np.ndarray) -> np.ndarray:
    """Of a matrix that does not mirror: the polar decomposition of scipy."""
    rotation, _ = polar(F)
    assert np.linalg.det(rotation) > 0
    return np.asarray(rotation)


def deformed_colour(model: GaussianModel, i: int, F: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """What Gaussian i shows from a direction: what it showed before from the direction turned back."""
    return sh_colour(model.sh[i].astype(float), nearest_rotation(F).T @ direction)
