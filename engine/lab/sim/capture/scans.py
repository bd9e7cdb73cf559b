"""From point clouds and LiDAR scans to Gaussian models.

Every point is placed by the pose that its sensor had at the point's own time. The cloud is then thinned to one point a
voxel, and stray points and small islands (sky, echoes under the ground) are dropped.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.flows.progress import Clock, Progress
from engine.lab.points.cloud import PointCloud
from engine.lab.points.reading import POINT_ENDINGS, read_point_cloud
from engine.lab.points.trajectory import Trajectory, read_trajectory
from engine.lab.sim.capture.capture_kernels import flat_kernels_from_points
from engine.model import Bool, Float32, Float64, GaussianModel, Int64


@dataclass(frozen=True, eq=False)
class Scan:
    """What a scanner saw in one turn, in its own frame, with a name for messages.

    `time` is when the scan began (or was taken at once), seconds, of the trajectory's clock.
    """

    cloud: PointCloud
    name: str = ""
    time: float | None = None


def poses_at(trajectory: Trajectory, times: npt.NDArray[Any]) -> tuple[Any, Float64]:
    """Poses between those of a trajectory with times: positions on a line, rotations on a great circle (slerp).

    For times (M,) within the trajectory's it gives a scipy Rotation of length M and positions (M, 3).
    """
    from scipy.spatial.transform import Rotation, Slerp  # costs 0.2 s, and the command line only passes by

    known = trajectory.times
    if known is None:
        raise InputError("the trajectory holds no times (KITTI): nothing can be placed between its poses")
    times = np.asarray(times, dtype=np.float64)
    outside = np.flatnonzero(~((times >= known[0]) & (times <= known[-1])))
    if len(outside):
        raise InputError(f"time {times[outside[0]]} lies outside the trajectory, {known[0]} to {known[-1]}")
    rotations = Rotation.from_quat(np.roll(trajectory.quats, -1, axis=1))
    if len(known) == 1:
        return rotations[np.zeros(len(times), dtype=int)], np.tile(trajectory.positions, (len(times), 1))
    places = np.stack([np.interp(times, known, trajectory.positions[:, axis]) for axis in range(3)], axis=1)
    return Slerp(known, rotations)(times), places


def place_scans(scans: Sequence[Scan], trajectory: Trajectory) -> tuple[list[PointCloud], int]:
    """Scans in the world, in the order in which they were taken, and the number of their points left out.

    Points taken before the first pose or after the last are left out; times are those of the trajectory's clock.

    1. A trajectory without times (KITTI) has one pose for each scan.
    2. Points with times of the trajectory's clock are placed each by its own pose. Several scans must follow each
       other in time, or their times are taken to start anew with each.
    3. Scans with a time of their own: their points' times count from it.
    4. As many scans as poses: each scan begins at its pose's time.
    """
    if trajectory.times is None:
        if len(scans) != len(trajectory):
            message = f"{len(scans)} scans for {len(trajectory)} poses without times (KITTI): each needs its own"
            raise InputError(message)
        placed = [
            replace(scan.cloud, points=scan.cloud.points @ pose[:3, :3].T + pose[:3, 3])
            for scan, pose in zip(scans, trajectory.matrices, strict=True)
        ]
        return placed, 0
    known = trajectory.times
    if _on_clock(scans, known):
        scans = [replace(scan, time=None) for scan in scans]
    elif any(scan.time is None for scan in scans):
        if len(scans) != len(trajectory):
            message = (
                f"it is unknown when the {len(scans)} scans were taken: their points have no times of the "
                f"trajectory's clock ({known[0]} to {known[-1]}), their names are no times, and there are "
                f"{len(trajectory)} poses"
            )
            raise InputError(message)
        scans = [replace(scan, time=float(time)) for scan, time in zip(scans, known, strict=True)]
    pairs = [place_scan(scan, trajectory) for scan in scans]
    return [cloud for cloud, _ in pairs], sum(outside for _, outside in pairs)


def _on_clock(scans: Sequence[Scan], known: Float64) -> bool:
    """Whether the points' own times are of the trajectory's clock."""
    spans = [(s.cloud.times.min(), s.cloud.times.max()) for s in scans if s.cloud.times is not None]
    if len(spans) < len(scans) or not all(last >= known[0] and first <= known[-1] for first, last in spans):
        return False
    return all(later[0] > earlier[0] for earlier, later in pairwise(spans))


def place_scan(scan: Scan, trajectory: Trajectory) -> tuple[PointCloud, int]:
    """One scan in the world, by its own time or by those of its points, and its points left out; see `place_scans`."""
    cloud, known = scan.cloud, trajectory.times
    if known is None:
        raise InputError("the trajectory holds no times (KITTI): it places one scan by each of its poses")
    times = _times(scan)
    inside = (times >= known[0]) & (times <= known[-1])
    if not inside.any():
        raise InputError(
            f"scan {scan.name!r}: its times, {times.min()} to {times.max()}, lie outside the trajectory's, "
            f"{known[0]} to {known[-1]}"
        )
    kept = cloud.take(inside)
    rotations, positions = poses_at(trajectory, times[inside])
    points = rotations.apply(kept.points) + positions
    return replace(kept, points=points, times=times[inside]), int(np.count_nonzero(~inside))


def _times(scan: Scan) -> Float64:
    """(N,) times of the trajectory's clock."""
    stamps = scan.cloud.times
    if scan.time is None:
        if stamps is None:
            raise InputError(f"scan {scan.name!r}: neither it nor its points have a time")
        return stamps
    if stamps is None:
        return np.full(len(scan.cloud), scan.time)
    return np.asarray(stamps - stamps.min() + scan.time)


def join_clouds(clouds: Sequence[PointCloud]) -> PointCloud:
    """All points in one cloud; what is not known of all of them (colors, intensities, times) is left out."""
    if not clouds:
        raise InputError("there are no clouds to join")

    def joined(name: str) -> Any:
        parts = [getattr(cloud, name) for cloud in clouds]
        return None if any(part is None for part in parts) else np.concatenate(parts)

    return PointCloud(*(joined(name) for name in ("points", "colors", "intensity", "times")))


_SAMPLE = 4096
_AREA_NEIGHBORS = 8
_MOST_VOXELS = 2**62

STRAY_NEIGHBORS = 12
STRAY_DEVIATIONS = 3.0
"""Points farther from their neighbors than the mean by so many standard deviations of its logarithm are strays.
The logarithm, since spacing grows with the distance to the scanner and is nowhere near normal."""

ISLAND_LINK = 6.0  # points closer than this many typical spacings belong together

ISLAND_SHARE = 2e-4
"""Groups that hold a smaller part of the cloud than this are islands: birds, glints, echoes under the ground."""


def thin_voxels(cloud: PointCloud, size: float) -> PointCloud:
    """One point a voxel of an edge of `size` scene units: the mean place, color, intensity and time of those in it.

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

    From the distance to the eighth neighbor, so that lines of a scanner, dense along and sparse across, count as
    the surface they lie on; from at most 4,096 points, evenly taken.
    """
    from scipy.spatial import cKDTree

    some = points[np.linspace(0, len(points) - 1, min(len(points), _SAMPLE)).astype(int)]
    k = min(_AREA_NEIGHBORS, len(points) - 1)
    if k < 1:
        return 0.0
    distances = cKDTree(points).query(some, k=[k + 1])[0][:, 0]
    apart = distances[distances > 0.0]
    return float(np.sqrt(np.pi / k) * np.median(apart)) if len(apart) else 0.0


def drop_strays(cloud: PointCloud) -> PointCloud:
    """Leave out points that no surface explains: lone ones, and small islands in the sky or under the ground.

    The cloud must be of even density, see `thin_voxels`.
    """
    if len(cloud) <= 2 * STRAY_NEIGHBORS:
        return cloud
    rest = cloud.take(_in_company(cloud.points))
    return rest.take(_on_land(rest.points))


def _in_company(points: Float64) -> Bool:
    """(N,) statistical outlier removal (Rusu et al. 2008), on the logarithm of the distance."""
    from scipy.spatial import cKDTree

    distances = cKDTree(points).query(points, k=STRAY_NEIGHBORS + 1)[0][:, 1:]
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


_DIGITS_LOST = 0.01
"""Part of the points' spacing that float32 may round away before the model gets an origin of its own."""

_SECONDS = re.compile(r"[0-9]+\.[0-9]+", re.ASCII)
_NANOSECONDS = re.compile(r"[0-9]{16,19}", re.ASCII)


MOST = 500_000
"""Points that a model is made of, at most; scans, which say one place many times, are thinned to the spacing of one."""


@dataclass(frozen=True, eq=False)
class CloudModel:
    """A model made of points."""

    model: GaussianModel
    cloud: PointCloud  # what it was made of: one point for each Gaussian, in the points' own frame
    # (3,) where the model's zero lies in that frame; not zero only where float32 would lose digits (map grids)
    origin: Float64
    points_read: int
    voxel: float  # edge of the voxels that keep one point each, scene units; 0: not thinned
    colors_from: str  # "colors", "intensity" or "none"


def points_to_model(path: str | os.PathLike[str], *, progress: Progress | None = None) -> CloudModel:
    """Make a model of a point cloud (PLY, PCD, LAS or LAZ). Progress has the stages "read", "thin" and "kernels"."""
    clock = Clock(progress)
    with clock.stage("read"):
        cloud, _ = read_point_cloud(path)
    return _to_model(cloud, clock)


def scans_to_model(
    scans: str | os.PathLike[str] | Sequence[Scan],
    trajectory: str | os.PathLike[str] | Trajectory,
    *,
    progress: Progress | None = None,
) -> CloudModel:
    """Make a model of LiDAR scans (or their folder or file, see `read_scans`) and the path of the scanner (TUM, KITTI).

    Progress has the stages "read", "place", "thin" and "kernels".
    """
    clock = Clock(progress)
    with clock.stage("read"):
        path = trajectory if isinstance(trajectory, Trajectory) else read_trajectory(trajectory)
        if isinstance(scans, str | os.PathLike):
            scans = read_scans(scans, clock)
    with clock.stage("place"):
        clouds, _ = place_scans(scans, path)
        cloud = replace(join_clouds(clouds), times=None)  # a mean of times says nothing
        spacing = float(np.median([typical_spacing(c.points) for c in clouds[:: max(1, len(clouds) // 8)]]))
    return _to_model(cloud, clock, spacing if len(clouds) > 1 else 0.0)


def read_scans(path: str | os.PathLike[str], clock: Clock | None = None) -> list[Scan]:
    """Read scans (a point cloud, or a folder of them) in the order of their files' names.

    A name that is a time (seconds with a decimal point, or nanoseconds of 16 to 19 digits) is the scan's time.
    """
    root = Path(path)
    files = [root]
    if root.is_dir():
        files = sorted(f for f in root.iterdir() if f.suffix.lower() in POINT_ENDINGS and f.is_file())
        if not files:
            raise InputError(f"{root}: holds no scans ({', '.join(POINT_ENDINGS)})")
    scans = []
    for k, file in enumerate(files):
        cloud, _ = read_point_cloud(file)
        scans.append(Scan(cloud, file.name, _time_of(file.stem)))
        if clock is not None:
            clock.advance((k + 1) / len(files))
    return scans


def _to_model(cloud: PointCloud, clock: Clock, spacing: float = 0.0) -> CloudModel:
    read = len(cloud)
    with clock.stage("thin"):
        cloud, voxel = _thinned(cloud, spacing)
        cloud = drop_strays(cloud)
    with clock.stage("kernels"):
        colors, source = _colors(cloud)
        origin = _origin(cloud.points)
        model = flat_kernels_from_points(cloud.points - origin, colors)
    return CloudModel(model, cloud, origin, read, voxel, source)


def _thinned(cloud: PointCloud, size: float) -> tuple[PointCloud, float]:
    """The cloud, and the edge of the voxels that thinned it (0: none did): `size`, or more if `MOST` asks for it."""
    thin = thin_voxels(cloud, size) if size > 0.0 else cloud
    while len(thin) > MOST:
        size = size or typical_spacing(cloud.points) or 1e-6 * float(np.ptp(cloud.points, axis=0).max() or 1.0)
        size *= max(1.05, float(np.sqrt(len(thin) / MOST)))  # surfaces: twice the size, a quarter left
        thin = thin_voxels(cloud, size)
    return thin, size


def _colors(cloud: PointCloud) -> tuple[Float32, str]:
    """(N, 3) colors; grey by intensity where a scanner saw none, the brightest and darkest 1 % cut off."""
    if cloud.colors is not None:
        return cloud.colors, "colors"
    if cloud.intensity is None or not len(cloud) or np.ptp(cloud.intensity) == 0.0:
        return np.full((len(cloud), 3), 0.5, dtype=np.float32), "none"
    low, high = np.percentile(cloud.intensity, (1.0, 99.0))
    grey = np.clip((cloud.intensity - low) / max(float(high - low), 1e-30), 0.0, 1.0).astype(np.float32)
    return np.repeat(grey[:, None], 3, axis=1), "intensity"


def _origin(points: Float64) -> Float64:
    """Zero, or a round place in the middle where float32 would merge neighbors."""
    largest = float(np.abs(points).max(initial=0.0))
    if len(points) < 2 or largest * np.finfo(np.float32).eps <= _DIGITS_LOST * typical_spacing(points):
        return np.zeros(3)
    return np.asarray(np.round(np.median(points, axis=0)))


def _time_of(stem: str) -> float | None:
    if _SECONDS.fullmatch(stem):
        return float(stem)
    return int(stem) * 1e-9 if _NANOSECONDS.fullmatch(stem) else None
