"""From a point cloud to flat kernels that lie on its surfaces: for clouds that no photo will train."""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import GaussianModel
from engine.sim.capture.kernels import kernels_from_points

__all__ = ["flat_kernels_from_points"]

_THINNEST = 0.05
"""Of the widest axis: thinner kernels flicker when seen from the edge and say nothing more."""

_LONGEST = 3.0
"""Of the middle axis: along the edge of a surface the neighbourhood is a line, the surface is not."""

_SMALLEST = 1e-3
"""Of the median kernel: where all neighbours are in one place, a kernel still has a size."""

_ROWS_AT_ONCE = 1 << 16


def flat_kernels_from_points(
    points: npt.NDArray[Any],
    colors: npt.NDArray[Any],
    *,
    neighbours: int = 12,
    opacity: float = 0.95,
    size: float = 1.0,
) -> GaussianModel:
    """One flat Gaussian for every point, turned into the plane of its neighbours (PCA).

    The k nearest points fill a disc of k times the area that a point has for itself; the standard deviations of a
    disc are half its radius, so 2 / sqrt(k) times those of the neighbourhood are the radius of a point's own disc.

    Parameters
    ----------
    points : (N, 3)
        Scene units, finite; N >= 4.
    colors : (N, 3)
        0 to 1, or uint8.
    neighbours : int
        k, at least 3; more of them make smoother surfaces and rounder edges.
    opacity : float
        Of every Gaussian, in (0, 1).
    size : float
        Factor on the standard deviations; below 0.8, evenly spaced points begin to show.

    Returns
    -------
    GaussianModel
        SH degree 0, in the order of the points; the third axis is the normal, up to its sign.

    Raises
    ------
    InputError
        As `kernels_from_points`; or if there are fewer than three neighbours.
    """
    from scipy.spatial import cKDTree

    from engine.numerics.similarity import rotation_to_quaternion

    round_ones = kernels_from_points(points, colors, opacity=opacity, size=size)  # and all that is checked there
    if neighbours < 3:
        raise InputError(f"neighbours is {neighbours}, expected at least 3")
    points = np.asarray(points, dtype=np.float64)
    k = min(neighbours, len(points) - 1)
    tree = cKDTree(points)
    log_scales, quats = round_ones.log_scales.copy(), round_ones.quats.copy()
    smallest = _SMALLEST * float(np.exp(np.median(round_ones.log_scales)))
    for start in range(0, len(points), _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, len(points)))
        near = points[tree.query(points[rows], k=k + 1)[1]]  # (B, k + 1, 3), the point itself among them
        near = near - near.mean(axis=1, keepdims=True)
        values, vectors = np.linalg.eigh(np.einsum("bki,bkj->bij", near, near) / (k + 1))
        values, vectors = values[:, ::-1], vectors[:, :, ::-1].copy()  # widest first, normal last
        vectors[np.linalg.det(vectors) < 0.0, :, 2] *= -1.0
        spread = np.maximum(size * 2.0 / np.sqrt(k) * np.sqrt(np.maximum(values, 0.0)), smallest)
        spread[:, 0] = np.minimum(spread[:, 0], _LONGEST * spread[:, 1])
        spread[:, 2] = np.maximum(spread[:, 2], _THINNEST * spread[:, 0])
        log_scales[rows] = np.log(spread)
        quats[rows] = rotation_to_quaternion(vectors)
    return round_ones.with_(log_scales=log_scales, quats=quats)
