"""LiDAR odometry: from scans alone to the path of the scanner (extra ``capture``: kiss-icp)."""

from collections.abc import Callable, Sequence

import numpy as np

from engine.errors import InputError
from engine.formats.cameras.trajectory import Trajectory
from engine.model import Bool, Float64
from engine.sim.capture.extras import load_extra
from engine.sim.capture.placing import Scan

__all__ = ["odometry"]

USUAL_RANGE = 100.0
"""Range, metres, that the thresholds of KISS-ICP are made for: scans of another are brought to it, and the path back.
Its voxels are then a metre, a hundredth of the range, as it says itself."""


def odometry(
    scans: Sequence[Scan], *, farthest: float | None = None, advance: Callable[[float], None] | None = None
) -> Trajectory:
    """Where the scanner was at each scan, by KISS-ICP (Vizzo et al. 2023).

    Parameters
    ----------
    scans : sequence of Scan
        In the order in which they were taken, each overlapping the one before; at least two. Where their points have
        times, the motion during a turn is undone.
    farthest : float, optional
        Ranges beyond it are not used, scene units; the largest of the first scan where not given.

    Returns
    -------
    Trajectory
        In the frame of the first scan; times where all scans have them.
    """
    from engine.numerics.similarity import rotation_to_quaternion  # scipy: the command line only passes by

    if len(scans) < 2:
        raise InputError(f"odometry needs at least two scans, got {len(scans)}")
    kiss = load_extra("kiss_icp.kiss_icp", "kiss-icp", "LiDAR odometry")
    reach = farthest or float(np.linalg.norm(scans[0].cloud.points, axis=1).max(initial=0.0))
    if not (np.isfinite(reach) and reach > 0.0):
        raise InputError(f"farthest is {reach}, expected a positive range")
    scale = USUAL_RANGE / reach
    config = load_extra("kiss_icp.config", "kiss-icp", "LiDAR odometry").KISSConfig()
    config.data.max_range, config.data.min_range = USUAL_RANGE, 0.0
    config.data.deskew = all(scan.cloud.times is not None for scan in scans)
    config.mapping.voxel_size = 0.01 * USUAL_RANGE
    config.registration.max_num_threads = 1  # the same bytes on every machine
    machine = kiss.KissICP(config)
    poses = []
    for k, scan in enumerate(scans):
        inside = np.linalg.norm(scan.cloud.points, axis=1) <= reach
        if not inside.any():
            raise InputError(f"scan {scan.name!r} holds no points within {reach:g}")
        machine.register_frame(scan.cloud.points[inside] * scale, _turn(scan, inside))
        poses.append(np.asarray(machine.last_pose, dtype=np.float64).copy())
        if advance is not None:
            advance((k + 1) / len(scans))
    matrices = np.stack(poses)
    times = [scan.time for scan in scans]
    known = np.array(times, dtype=np.float64) if all(time is not None for time in times) else None
    return Trajectory(matrices[:, :3, 3] / scale, rotation_to_quaternion(matrices[:, :3, :3]), known)


def _turn(scan: Scan, inside: Bool) -> Float64:
    """(N,) part of the turn, 0 to 1, at which each point was taken; empty where that is not known."""
    times = scan.cloud.times
    if times is None:
        return np.empty(0)
    chosen = times[inside]
    return np.asarray((chosen - chosen.min()) / max(float(np.ptp(chosen)), 1e-9))
