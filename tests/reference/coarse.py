"""Slow, obviously right twin of the moments about places in engine.registration.coarse."""

from __future__ import annotations

import numpy as np


def moments(
    mass: np.ndarray, where: np.ndarray, color: np.ndarray, place: np.ndarray, window: float, reach: float
) -> tuple[np.ndarray, int]:
    """(2, 22) of one place, and the voxels within reach."""
    offset = where - place
    near = np.linalg.norm(offset, axis=1) <= reach
    rows = []
    for width in (0.5 * window, window):
        g = np.where(near, mass * np.exp(-0.5 * (np.linalg.norm(offset, axis=1) / width) ** 2), 0.0)
        second = np.einsum("v,vi,vj->ij", g, offset, offset)
        upper = [second[0, 0], second[1, 1], second[2, 2], second[0, 1], second[1, 2], second[2, 0]]
        slopes = np.einsum("v,vc,vi->ci", g, color, offset)
        rows.append(np.concatenate([[g.sum()], g @ offset, upper, g @ color, slopes.ravel()]))
    return np.array(rows), int(near.sum())
