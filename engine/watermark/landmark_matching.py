"""Which landmark does each keypoint of a picture show?

A place seen in several views is in the bank several times, so its copies must not fail the ratio test against
each other: the rival of the best match is the best match *elsewhere*.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from engine.model import Float32, Float64, Int64
from engine.numerics.jit import parallel_kernel, parallel_section
from engine.watermark.features import Keypoints
from engine.watermark.landmarks import Landmarks

__all__ = ["match_landmarks"]

_KERNEL_VERSION = 1
_CHUNK = 256
"""Keypoints matched at a time: 256 rows of 20,000 distances are 20 MB."""


@parallel_kernel
def _best_and_rival(products, squares, points, radius, best, first, rival):  # type: ignore[no-untyped-def]
    for k in prange(products.shape[0]):
        nearest, distance = 0, np.inf
        for n in range(products.shape[1]):
            d = squares[n] - 2.0 * products[k, n]
            if d < distance:
                nearest, distance = n, d
        x, y, z = points[nearest, 0], points[nearest, 1], points[nearest, 2]
        second = np.inf
        for n in range(products.shape[1]):
            d = squares[n] - 2.0 * products[k, n]
            if d < second:
                away = (points[n, 0] - x) ** 2 + (points[n, 1] - y) ** 2 + (points[n, 2] - z) ** 2
                if away > radius * radius:
                    second = d
        best[k], first[k], rival[k] = nearest, distance, second


def match_landmarks(
    keypoints: Keypoints, landmarks: Landmarks, ratio: float, radius: float
) -> tuple[Int64, Int64, Float64]:
    """Match keypoints to landmarks by Lowe's ratio test between different places.

    Parameters
    ----------
    keypoints : Keypoints
        P of a picture.
    landmarks : Landmarks
    ratio : float
        Largest accepted ratio of the two distances, 0..1.
    radius : float
        Landmarks nearer than this to the best match are the same place, scene units.

    Returns
    -------
    keypoint, landmark : (M,) int64
        Matching indices, by rising keypoint.
    ratios : (M,) float64
        The ratio of each match: the smaller, the surer.
    """
    none = np.zeros(0, dtype=np.int64)
    if len(keypoints) == 0 or len(landmarks) < 2:
        return none, none, np.zeros(0)
    target = landmarks.descriptors.astype(np.float32)  # (L, 128)
    squares = np.einsum("ij,ij->i", target, target)
    points = np.ascontiguousarray(landmarks.points, dtype=np.float32)
    count = len(keypoints)
    best = np.empty(count, dtype=np.int64)
    first, rival = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
    query: Float32 = keypoints.descriptors.astype(np.float32)
    for low in range(0, count, _CHUNK):
        part = slice(low, low + _CHUNK)
        products = query[part] @ target.T  # exact: sums of integers below 2^24
        with parallel_section():
            _best_and_rival(
                products, squares, points, np.float32(radius), best[part], first[part], rival[part]
            )
    own = np.einsum("ij,ij->i", query, query)
    ratios = np.sqrt(np.maximum(first + own, 0.0) / np.maximum(rival + own, 1e-6)).astype(np.float64)
    chosen = np.nonzero(ratios < ratio)[0]
    return chosen, best[chosen], ratios[chosen]
