"""Scans into the world: every point by the pose that its sensor had at the point's own time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.points.cloud import PointCloud
from engine.lab.points.trajectory import Trajectory
from engine.model import Float64

__all__ = ["Scan", "join_clouds", "place_scan", "place_scans", "poses_at"]


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


def place_scans(
    scans: Sequence[Scan], trajectory: Trajectory, mounting: Float64 | None = None
) -> tuple[list[PointCloud], int]:
    """Scans in the world, in the order in which they were taken, and the number of their points left out.

    Points taken before the first pose or after the last are left out; times are those of the trajectory's clock.
    `mounting`, a rigid (4, 4), leads from the scanner's frame to that of the poses (KITTI's ``Tr``).

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
            replace(scan.cloud, points=mounted(scan.cloud.points, mounting) @ pose[:3, :3].T + pose[:3, 3])
            for scan, pose in zip(scans, trajectory.matrices, strict=True)
        ]
        return placed, 0
    known = trajectory.times
    if _on_clock(scans, known):
        scans = [replace(scan, time=None) for scan in scans]
    elif any(scan.time is None for scan in scans):
        if len(scans) != len(trajectory):
            message = (
                f"nothing tells when the {len(scans)} scans were taken: their points have no times of the "
                f"trajectory's clock ({known[0]} to {known[-1]}), their names are no times, and there are "
                f"{len(trajectory)} poses"
            )
            raise InputError(message)
        scans = [replace(scan, time=float(time)) for scan, time in zip(scans, known, strict=True)]
    pairs = [place_scan(scan, trajectory, mounting) for scan in scans]
    return [cloud for cloud, _ in pairs], sum(outside for _, outside in pairs)


def _on_clock(scans: Sequence[Scan], known: Float64) -> bool:
    """Whether the points' own times are of the trajectory's clock."""
    spans = [(s.cloud.times.min(), s.cloud.times.max()) for s in scans if s.cloud.times is not None]
    if len(spans) < len(scans) or not all(last >= known[0] and first <= known[-1] for first, last in spans):
        return False
    return all(later[0] > earlier[0] for earlier, later in pairwise(spans))


def place_scan(scan: Scan, trajectory: Trajectory, mounting: Float64 | None = None) -> tuple[PointCloud, int]:
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
    points = rotations.apply(mounted(kept.points, mounting)) + positions
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


def mounted(points: Float64, mounting: Float64 | None) -> Float64:
    """Points in the frame of the trajectory."""
    if mounting is None:
        return points
    matrix = np.asarray(mounting, dtype=np.float64)
    rigid = matrix.shape == (4, 4) and np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-3)
    if not (rigid and np.isfinite(matrix).all() and np.linalg.det(matrix[:3, :3]) > 0):
        raise InputError(f"the mounting must be a rigid (4, 4) matrix, got {matrix.tolist()}")
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


def join_clouds(clouds: Sequence[PointCloud]) -> PointCloud:
    """All points in one cloud; what is not known of all of them (colours, intensities, times) is left out."""
    if not clouds:
        raise InputError("there are no clouds to join")

    def joined(name: str) -> Any:
        parts = [getattr(cloud, name) for cloud in clouds]
        return None if any(part is None for part in parts) else np.concatenate(parts)

    return PointCloud(*(joined(name) for name in ("points", "colors", "intensity", "times")))
