"""Slow twins of engine.registration.match_kernels, from the definitions."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def evidence(
    x: np.ndarray,
    y: np.ndarray,
    size: np.ndarray,
    turn: np.ndarray,
    moved: np.ndarray,
    tol_size: float,
    extent: float,
    chance: np.ndarray,
) -> tuple[float, int]:
    """Of pairs whose sizes fit: how much likelier so many lie within a tolerance than by chance, at the best one."""
    fits = np.abs(size - np.log(moved[0])) <= tol_size
    error2 = np.square(moved[0] * x @ turn.T + moved[1:] - y).sum(axis=1)[fits] / extent**2
    best, at = 0.0, -1
    for number, share in enumerate(chance):
        k = (error2 <= 2.0**-number).sum() - 3.0
        expected = fits.sum() * share
        if k > expected and k * np.log(k / expected) - (k - expected) > best:
            best, at = k * np.log(k / expected) - (k - expected), number
    return best, at


def degrees(
    x: np.ndarray, y: np.ndarray, size: np.ndarray, turn: np.ndarray, tol_size: float, tol_edge: float, angle: float
) -> np.ndarray:
    """With how many others each pair agrees: in size, in length, and where an angle is given in turn and direction."""
    n = len(x)
    count = np.zeros(n, int)
    for i in range(n):
        for j in range(n):
            if i == j or abs(size[i] - size[j]) > tol_size:
                continue
            a, b = x[j] - x[i], y[j] - y[i]
            if abs(np.log(np.linalg.norm(b) / np.linalg.norm(a)) - (size[i] + size[j]) / 2) > tol_edge:
                continue
            if np.isfinite(angle):
                first, second = (Rotation.from_quat(np.roll(q, -1)) for q in (turn[i], turn[j]))
                cosine = first.apply(a) @ b / np.linalg.norm(a) / np.linalg.norm(b)
                if (first.inv() * second).magnitude() > angle or np.arccos(np.clip(cosine, -1, 1)) > angle:
                    continue
            count[i] += 1
    return count
