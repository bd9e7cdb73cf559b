"""From a colored point cloud to Gaussian kernels: round ones, as INRIA starts its training, or flat ones.

Flat kernels lie on the surfaces of the cloud and are for clouds that no photo will train.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import SH_C0, Float64, GaussianModel

_NEIGHBORS = 3
_SMALLEST = 1e-3
"""Points closer to each other than this part of the cloud's median spacing count as one place: a kernel of no
size would never be seen and never be moved. Also, of the median kernel, the size of one whose neighbors all are in
one place."""

_THINNEST = 0.05  # of the widest axis: thinner kernels flicker when seen from the edge and say nothing more
_LONGEST = 3.0  # of the middle axis: along the edge of a surface the neighborhood is a line, the surface is not

PLANE_NEIGHBORS = 12  # more make smoother surfaces and rounder edges
FLAT_OPACITY = 0.95

_ROWS_AT_ONCE = 1 << 16


def kernels_from_points(points: npt.NDArray[Any], colors: npt.NDArray[Any], *, opacity: float = 0.1) -> GaussianModel:
    """One round Gaussian for every point, as wide as its three nearest neighbors are far (Kerbl et al. 2023).

    Points (N, 3) are finite, N >= 4; colors (N, 3) 0 to 1, or uint8. The model has SH degree 0, one opacity in (0, 1)
    and the order of the points; the standard deviation is the root mean square distance to the three nearest others.
    """
    from scipy.spatial import cKDTree  # costs 0.2 s, and the command line only passes by

    points = np.asarray(points, dtype=np.float64)
    given = np.asarray(colors)
    shades = given / 255.0 if given.dtype == np.uint8 else given.astype(np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or shades.shape != points.shape:
        raise InputError(f"points have shape {points.shape} and colors {shades.shape}, expected (N, 3) for both")
    if len(points) <= _NEIGHBORS:
        raise InputError(f"kernels need at least {_NEIGHBORS + 1} points, got {len(points)}")
    for what, array in (("points", points), ("colors", shades)):
        bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
        if len(bad):
            raise InputError(f"{what}: row {bad[0]} is not finite: {array[bad[0]].tolist()}")
    if shades.min() < 0.0 or shades.max() > 1.0:
        raise InputError(f"colors lie between {shades.min():g} and {shades.max():g}, expected 0 to 1 or uint8")
    if not 0.0 < opacity < 1.0:
        raise InputError(f"opacity is {opacity}, expected to lie in (0, 1)")

    distances = cKDTree(points).query(points, k=_NEIGHBORS + 1)[0][:, 1:]  # (N, 3)
    spread = np.sqrt(np.mean(distances**2, axis=1))
    typical = np.median(spread[spread > 0.0]) if (spread > 0.0).any() else 1.0
    spread = np.maximum(spread, _SMALLEST * typical)
    quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (len(points), 1))
    return GaussianModel(
        points.astype(np.float32),
        np.repeat(np.log(spread)[:, None], 3, axis=1).astype(np.float32),
        quats,
        np.full(len(points), np.log(opacity / (1.0 - opacity)), dtype=np.float32),
        ((shades - 0.5) / SH_C0).astype(np.float32)[:, None],
    )


def flat_kernels_from_points(points: npt.NDArray[Any], colors: npt.NDArray[Any]) -> GaussianModel:
    """One flat Gaussian for every point, turned into the plane of its neighbors (PCA).

    The k nearest points fill a disc of k times the area that a point has for itself; the standard deviations of a
    disc are half its radius, so 2 / sqrt(k) times those of the neighborhood are the radius of a point's own disc.

    The third axis is the normal, up to its sign. All else as of `kernels_from_points`.
    """
    from scipy.spatial import cKDTree

    from engine.numerics.similarity import rotation_to_quaternion

    round_ones = kernels_from_points(points, colors, opacity=FLAT_OPACITY)  # and all that is checked there
    points = np.asarray(points, dtype=np.float64)
    k = min(PLANE_NEIGHBORS, len(points) - 1)
    tree = cKDTree(points)
    log_scales, quats = round_ones.log_scales.copy(), round_ones.quats.copy()
    smallest = _SMALLEST * float(np.exp(np.median(round_ones.log_scales)))
    for start in range(0, len(points), _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, len(points)))
        near = points[tree.query(points[rows], k=k + 1)[1]]  # (B, k + 1, 3), the point itself among them
        near = near - near.mean(axis=1, keepdims=True)
        values, vectors = principal_axes(np.einsum("bki,bkj->bij", near, near) / (k + 1))  # (B, 3), (B, 3, 3)
        spread = np.maximum(2.0 / np.sqrt(k) * np.sqrt(np.maximum(values, 0.0)), smallest)
        spread[:, 0] = np.minimum(spread[:, 0], _LONGEST * spread[:, 1])
        spread[:, 2] = np.maximum(spread[:, 2], _THINNEST * spread[:, 0])
        log_scales[rows] = np.log(spread)
        quats[rows] = rotation_to_quaternion(vectors)
    return round_ones.with_(log_scales=log_scales, quats=quats)


def principal_axes(covariances: Float64) -> tuple[Float64, Float64]:
    """Variances (n, 3), the largest first, of covariances (n, 3, 3), and their axes: columns of rotations (n, 3, 3)."""
    values, vectors = np.linalg.eigh(covariances)
    vectors = vectors[:, :, ::-1].copy()  # the shortest axis last, as discs have it
    vectors[np.linalg.det(vectors) < 0.0, :, 2] *= -1.0
    return values[:, ::-1], vectors
