"""From point clouds and LiDAR scans to Gaussian models."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from engine.errors import InputError
from engine.flows.progress import Clock, Progress
from engine.formats.repairs import Repair
from engine.lab.points.cloud import PointCloud
from engine.lab.points.reading import POINT_ENDINGS, read_point_cloud
from engine.lab.points.trajectory import Trajectory, read_trajectory
from engine.lab.sim.capture.capture_kernels import flat_kernels_from_points, kernels_from_points
from engine.lab.sim.capture.placing import Scan, join_clouds, place_scans
from engine.lab.sim.capture.thinning import drop_strays, thin_voxels, typical_spacing
from engine.model import Float32, Float64, GaussianModel

__all__ = ["CloudConfig", "CloudModel", "points_to_model", "read_scans", "scans_to_model"]

_DIGITS_LOST = 0.01
"""Part of the points' spacing that float32 may round away before the model gets an origin of its own."""

_SECONDS = re.compile(r"[0-9]+\.[0-9]+", re.ASCII)
_NANOSECONDS = re.compile(r"[0-9]{16,19}", re.ASCII)


@dataclass(frozen=True)
class CloudConfig:
    """Knobs between a cloud and its kernels."""

    # edge of a voxel that keeps one point, scene units; 0 keeps all points. None: the spacing of a single scan, since
    # many scans of one place say it many times; of a plain cloud, all points; more if `most` asks for it
    voxel: float | None = None
    most: int = 500_000  # points wanted at most, where `voxel` is None
    clean: bool = True  # leave out lone points and small islands (sky, echoes under the ground)
    # flat ones lie on the surfaces and are for looking at; round ones are what training starts from (INRIA)
    kernels: Literal["flat", "round"] = "flat"
    opacity: float | None = None  # of every kernel, in (0, 1); None: 0.95 of flat ones, 0.1 of round ones
    size: float = 1.0  # factor on the standard deviations

    def __post_init__(self) -> None:
        if self.most < 4:
            raise InputError(f"most is {self.most}, expected at least 4 points")
        if self.kernels not in ("flat", "round"):
            raise InputError(f"kernels must be 'flat' or 'round', got {self.kernels!r}")


@dataclass(frozen=True, eq=False)
class CloudModel:
    """A model made of points."""

    model: GaussianModel
    cloud: PointCloud  # what it was made of: one point for each Gaussian, in the points' own frame
    # (3,) where the model's zero lies in that frame; not zero only where float32 would lose digits (map grids)
    origin: Float64
    # plain values: points read, placed and kept, voxel, where the colours are from, repairs, seconds
    report: dict[str, Any]


def points_to_model(
    path: str | os.PathLike[str], *, config: CloudConfig | None = None, progress: Progress | None = None
) -> CloudModel:
    """Make a model of a point cloud (PLY, PCD or LAS). Progress has the stages "read", "thin" and "kernels"."""
    clock = Clock(progress)
    with clock.stage("read"):
        cloud, repairs = read_point_cloud(path)
    return _to_model(cloud, repairs, config or CloudConfig(), clock, {})


def scans_to_model(
    scans: str | os.PathLike[str] | Sequence[Scan],
    trajectory: str | os.PathLike[str] | Trajectory,
    *,
    config: CloudConfig | None = None,
    mounting: Float64 | None = None,
    progress: Progress | None = None,
) -> CloudModel:
    """Make a model of LiDAR scans (or their folder or file, see `read_scans`) and the path of the scanner (TUM, KITTI).

    `mounting` (4, 4) leads from the scanner's frame to the one whose poses the trajectory tells. Progress has the
    stages "read", "place", "thin" and "kernels".
    """
    clock = Clock(progress)
    repairs: tuple[Repair, ...] = ()
    with clock.stage("read"):
        path = trajectory if isinstance(trajectory, Trajectory) else read_trajectory(trajectory)
        if isinstance(scans, str | os.PathLike):
            scans, repairs = read_scans(scans, clock)
    with clock.stage("place"):
        clouds, outside = place_scans(scans, path, mounting)
        cloud = replace(join_clouds(clouds), times=None)  # a mean of times says nothing
        spacing = float(np.median([typical_spacing(c.points) for c in clouds[:: max(1, len(clouds) // 8)]]))
    report = {"scans": len(scans), "poses": len(path), "points_outside": outside}
    return _to_model(cloud, repairs, config or CloudConfig(), clock, report, spacing if len(clouds) > 1 else 0.0)


def read_scans(path: str | os.PathLike[str], clock: Clock | None = None) -> tuple[list[Scan], tuple[Repair, ...]]:
    """Read scans (a point cloud, or a folder of them) in the order of their files' names; repairs are summed up.

    A name that is a time (seconds with a decimal point, or nanoseconds of 16 to 19 digits) is the scan's time.
    """
    root = Path(path)
    files = [root]
    if root.is_dir():
        files = sorted(f for f in root.iterdir() if f.suffix.lower() in POINT_ENDINGS and f.is_file())
        if not files:
            raise InputError(f"{root}: holds no scans ({', '.join(POINT_ENDINGS)})")
    scans, counts = [], Counter[str]()
    for k, file in enumerate(files):
        cloud, repairs = read_point_cloud(file)
        scans.append(Scan(cloud, file.name, _time_of(file.stem)))
        for repair in repairs:
            counts[repair.code] += repair.count
        if clock is not None:
            clock.advance((k + 1) / len(files))
    return scans, tuple(Repair(code, n, f"{n} in {len(files)} scans") for code, n in counts.items())


def _to_model(
    cloud: PointCloud,
    repairs: tuple[Repair, ...],
    config: CloudConfig,
    clock: Clock,
    report: dict[str, Any],
    spacing: float = 0.0,
) -> CloudModel:
    read = len(cloud)
    with clock.stage("thin"):
        cloud, voxel = _thinned(cloud, config, spacing)
        cloud, strays = drop_strays(cloud) if config.clean else (cloud, 0)
    with clock.stage("kernels"):
        colors, source = _colors(cloud)
        origin = _origin(cloud.points)
        own = {} if config.opacity is None else {"opacity": config.opacity}
        make = flat_kernels_from_points if config.kernels == "flat" else kernels_from_points
        model = make(cloud.points - origin, colors, size=config.size, **own)
    report |= {
        "repairs": {repair.code: repair.count for repair in repairs},
        "points": read,
        "voxel": voxel,
        "strays_dropped": strays,
        "gaussians": len(model),
        "colors_from": source,
        "origin": origin.tolist(),
        "seconds_by_stage": clock.seconds,
    }
    return CloudModel(model, cloud, origin, report)


def _thinned(cloud: PointCloud, config: CloudConfig, spacing: float) -> tuple[PointCloud, float]:
    """The cloud, and the edge of the voxels it was thinned by (0: not at all)."""
    size = spacing if config.voxel is None else config.voxel
    thin = thin_voxels(cloud, size) if size > 0.0 else cloud
    while config.voxel is None and len(thin) > config.most:
        size = size or typical_spacing(cloud.points) or 1e-6 * float(np.ptp(cloud.points, axis=0).max() or 1.0)
        size *= max(1.05, float(np.sqrt(len(thin) / config.most)))  # surfaces: twice the size, a quarter left
        thin = thin_voxels(cloud, size)
    return thin, size


def _colors(cloud: PointCloud) -> tuple[Float32, str]:
    """(N, 3) colours; grey by intensity where a scanner saw none, the brightest and darkest 1 % cut off."""
    if cloud.colors is not None:
        return cloud.colors, "colors"
    if cloud.intensity is None or not len(cloud) or np.ptp(cloud.intensity) == 0.0:
        return np.full((len(cloud), 3), 0.5, dtype=np.float32), "none"
    low, high = np.percentile(cloud.intensity, (1.0, 99.0))
    grey = np.clip((cloud.intensity - low) / max(float(high - low), 1e-30), 0.0, 1.0).astype(np.float32)
    return np.repeat(grey[:, None], 3, axis=1), "intensity"


def _origin(points: Float64) -> Float64:
    """Zero, or a round place in the middle where float32 would not tell neighbours apart."""
    largest = float(np.abs(points).max(initial=0.0))
    if len(points) < 2 or largest * np.finfo(np.float32).eps <= _DIGITS_LOST * typical_spacing(points):
        return np.zeros(3)
    return np.asarray(np.round(np.median(points, axis=0)))


def _time_of(stem: str) -> float | None:
    if _SECONDS.fullmatch(stem):
        return float(stem)
    return int(stem) * 1e-9 if _NANOSECONDS.fullmatch(stem) else None
