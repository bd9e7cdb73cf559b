"""A cloud made even and clean: one point a voxel, and without what hangs in the sky or lies under the ground."""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.points.cloud import PointCloud
from engine.model import Bool, Float64, Int64

__all__ = ["drop_strays", "thin_voxels", "typical_spacing"]

_SAMPLE = 4096
_AREA_NEIGHBOURS = 8
_MOST_VOXELS = 2**62

STRAY_NEIGHBOURS = 12
STRAY_DEVIATIONS = 3.0
"""Points farther from their neighbours than the mean by so many standard deviations of its logarithm are strays.
The logarithm, since spacing grows with the distance to the scanner and is nowhere near normal."""

ISLAND_LINK = 6.0  # points closer than this many typical spacings belong together

ISLAND_SHARE = 2e-4
"""Groups that hold a smaller part of the cloud than this are islands: birds, glints, echoes under the ground."""


def thin_voxels(cloud: PointCloud, size: float) -> PointCloud:
    """One point a voxel of an edge of `size` scene units: the mean place, colour, intensity and time of those in it.

    In the order of the voxels, whatever the order of the points but for rounding.
    """
    if not (np.isfinite(size) and size > 0.0):
        raise InputError(f"size of a voxel is {size}, expected a positive length")
    if len(cloud) == 0:
        return cloud
    low = cloud.points.min(axis=0)
    extent = (cloud.points.max(axis=0) - low) / size
    if np.prod(extent + 1.0) > _MOST_VOXELS:
        raise InputError(f"voxels of {size:g} are too small for a cloud of {float(extent.max() * size):g}")
    cells = np.floor((cloud.points - low) / size).astype(np.int64)
    counts = cells.max(axis=0) + 1
    keys: Int64 = (cells[:, 0] * counts[1] + cells[:, 1]) * counts[2] + cells[:, 2]
    _, voxel, held = np.unique(keys, return_inverse=True, return_counts=True)

    def mean(values: npt.NDArray[Any]) -> Float64:
        columns = values.reshape(len(values), -1).astype(np.float64)
        sums = [np.bincount(voxel, column, len(held)) for column in columns.T]
        return np.asarray((np.stack(sums, axis=1) / held[:, None]).reshape(len(held), *values.shape[1:]))

    middle = low + size * 0.5  # near the voxels: sums of large coordinates would lose digits
    colors, intensity = (None if a is None else mean(a).astype(np.float32) for a in (cloud.colors, cloud.intensity))
    times = None if cloud.times is None else mean(cloud.times)
    return PointCloud(mean(cloud.points - middle) + middle, colors, intensity, times)


def typical_spacing(points: Float64) -> float:
    """Edge of the square that a point has for itself on its surface, scene units; the median.

    From the distance to the eighth neighbour, so that lines of a scanner, dense along and sparse across, count as
    the surface they lie on; from at most 4,096 points, evenly taken.
    """
    from scipy.spatial import cKDTree

    some = points[np.linspace(0, len(points) - 1, min(len(points), _SAMPLE)).astype(int)]
    k = min(_AREA_NEIGHBOURS, len(points) - 1)
    if k < 1:
        return 0.0
    distances = cKDTree(points).query(some, k=[k + 1])[0][:, 0]
    apart = distances[distances > 0.0]
    return float(np.sqrt(np.pi / k) * np.median(apart)) if len(apart) else 0.0


def drop_strays(cloud: PointCloud) -> tuple[PointCloud, int]:
    """Leave out points that no surface explains: lone ones, and small islands in the sky or under the ground.

    The cloud must be of even density, see `thin_voxels`. Returned with the number of points dropped.
    """
    if len(cloud) <= 2 * STRAY_NEIGHBOURS:
        return cloud, 0
    rest = cloud.take(_in_company(cloud.points))
    rest = rest.take(_on_land(rest.points))
    return rest, len(cloud) - len(rest)


def _in_company(points: Float64) -> Bool:
    """(N,) statistical outlier removal (Rusu et al. 2008), on the logarithm of the distance."""
    from scipy.spatial import cKDTree

    distances = cKDTree(points).query(points, k=STRAY_NEIGHBOURS + 1)[0][:, 1:]
    spacing = np.log(np.maximum(distances.mean(axis=1), np.finfo(np.float64).tiny))
    return np.asarray(spacing <= spacing.mean() + STRAY_DEVIATIONS * spacing.std())


def _on_land(points: Float64) -> Bool:
    """(N,) points of groups that are large enough; groups are of voxels that touch, at corners too."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    link = ISLAND_LINK * typical_spacing(points)
    if link <= 0.0:
        return np.ones(len(points), dtype=np.bool_)
    cells = np.floor((points - points.min(axis=0)) / link).astype(np.int64)
    occupied, cell = np.unique(cells, axis=0, return_inverse=True)
    pairs = cKDTree(occupied).query_pairs(1.8, output_type="ndarray")  # sqrt(3) reaches the corners
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(occupied),) * 2)
    group = connected_components(links, directed=False)[1][cell.reshape(-1)]
    sizes = np.bincount(group)
    return np.asarray(sizes[group] >= min(max(ISLAND_SHARE * len(points), 3.0), sizes.max()))
