"""From a coloured point cloud to Gaussian kernels, as INRIA starts its training."""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import SH_C0, GaussianModel

__all__ = ["kernels_from_points"]

_NEIGHBOURS = 3
_SMALLEST = 1e-3
"""Points closer to each other than this part of the cloud's median spacing count as one place: a kernel of no
size would never be seen and never be moved."""


def kernels_from_points(
    points: npt.NDArray[Any], colors: npt.NDArray[Any], *, opacity: float = 0.1, size: float = 1.0
) -> GaussianModel:
    """One round Gaussian for every point, as wide as its three nearest neighbours are far (Kerbl et al. 2023).

    Parameters
    ----------
    points : (N, 3)
        Scene units, finite; N >= 4.
    colors : (N, 3)
        Colours of the points: 0 to 1, or uint8.
    opacity : float
        Of every Gaussian, in (0, 1).
    size : float
        Factor on the standard deviations; a dense scan that needs no training looks solid at about 0.7.

    Returns
    -------
    GaussianModel
        SH degree 0, in the order of the points; the standard deviation is the root mean square distance to the
        three nearest others.

    Raises
    ------
    InputError
        If a shape is wrong, there are fewer than four points, a number is not finite, a colour lies outside its
        range, or the opacity or size outside theirs.
    """
    from scipy.spatial import cKDTree  # costs 0.2 s, and the command line only passes by

    points = np.asarray(points, dtype=np.float64)
    given = np.asarray(colors)
    shades = given / 255.0 if given.dtype == np.uint8 else given.astype(np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or shades.shape != points.shape:
        raise InputError(f"points have shape {points.shape} and colors {shades.shape}, expected (N, 3) for both")
    if len(points) <= _NEIGHBOURS:
        raise InputError(f"kernels need at least {_NEIGHBOURS + 1} points, got {len(points)}")
    for what, array in (("points", points), ("colors", shades)):
        bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
        if len(bad):
            raise InputError(f"{what}: row {bad[0]} is not finite: {array[bad[0]].tolist()}")
    if shades.min() < 0.0 or shades.max() > 1.0:
        raise InputError(f"colors lie between {shades.min():g} and {shades.max():g}, expected 0 to 1 or uint8")
    if not 0.0 < opacity < 1.0:
        raise InputError(f"opacity is {opacity}, expected to lie in (0, 1)")
    if not (np.isfinite(size) and size > 0.0):
        raise InputError(f"size is {size}, expected a positive factor")

    n = len(points)
    distances = cKDTree(points).query(points, k=_NEIGHBOURS + 1)[0][:, 1:]
    spread = np.sqrt(np.mean(distances**2, axis=1))
    typical = np.median(spread[spread > 0.0]) if (spread > 0.0).any() else 1.0
    spread = np.maximum(spread, _SMALLEST * typical) * size
    quats = np.zeros((n, 4), dtype=np.float32)
    quats[:, 0] = 1.0
    return GaussianModel(
        points.astype(np.float32),
        np.repeat(np.log(spread)[:, None], 3, axis=1).astype(np.float32),
        quats,
        np.full(n, np.log(opacity / (1.0 - opacity)), dtype=np.float32),
        ((shades - 0.5) / SH_C0).astype(np.float32)[:, None],
    )
