"""Slow twin of engine.registration.mixtures: every part against every whole, by matrices."""

from __future__ import annotations

import numpy as np


def squared_distance(point: np.ndarray, sigma: np.ndarray, centre: np.ndarray, whole: np.ndarray) -> float:
    """Expected squared Mahalanobis distance of a part N(point, sigma) from a whole N(centre, whole)."""
    gap = point - centre
    return float(gap @ np.linalg.solve(whole, gap) + np.trace(np.linalg.solve(whole, sigma)))


def likeliest_whole(
    point: np.ndarray,
    sigma: np.ndarray,
    color: np.ndarray,
    centres: np.ndarray,
    wholes: np.ndarray,
    colors: np.ndarray,
    *,
    color_std: float,
    limit: float,
) -> tuple[int, float]:
    """Row of the whole with the least expected negative log likelihood, -1 and infinity where it lies too far."""
    costs = [
        squared_distance(point, sigma, c, w) + np.log(np.linalg.det(w)) + np.square((color - q) / color_std).sum()
        for c, w, q in zip(centres, wholes, colors, strict=True)
    ]
    best = int(np.argmin(costs))
    distance2 = squared_distance(point, sigma, centres[best], wholes[best])
    return (best, distance2) if distance2 <= limit else (-1, np.inf)
