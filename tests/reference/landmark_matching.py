"""Slow twins of the kernels of engine/pictures/landmarks/landmark_matching.py."""

from __future__ import annotations

import numpy as np


def rank(query: np.ndarray, target: np.ndarray, points: np.ndarray, radius: float) -> tuple[int, float, float]:
    """Best landmark of one descriptor, its squared distance, and the best squared distance elsewhere."""
    square = ((target.astype(np.int64) - query.astype(np.int64)) ** 2).sum(axis=1)
    best = int(np.argmin(square))
    elsewhere = np.linalg.norm(points - points[best], axis=1) > radius
    return best, float(square[best]), float(square[elsewhere].astype(np.float64).min(initial=np.inf))


def nearest_look(
    pixel: np.ndarray, descriptor: np.ndarray, places: np.ndarray, targets: np.ndarray, radius: float
) -> tuple[int, int]:
    """Of the landmarks in the square around a pixel, the one most alike, and its squared distance."""
    near = np.nonzero((np.abs(places - pixel) < radius).all(axis=1))[0]
    if not len(near):
        return -1, 1 << 30
    square = ((targets[near].astype(np.int64) - descriptor.astype(np.int64)) ** 2).sum(axis=1)
    return int(near[np.argmin(square)]), int(square.min())
