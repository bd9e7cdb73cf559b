"""Poses of photos and scans, estimated from nothing but themselves by packages of the extra ``capture``.

Structure from motion (pycolmap) makes a COLMAP model of photos, LiDAR odometry (kiss-icp) a path of scans.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.extras import load_extra
from engine.flows.progress import Clock, Progress
from engine.lab.points.trajectory import Trajectory
from engine.lab.sim.capture.scans import Scan
from engine.model import Bool, Float64

PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp")
_LONGEST_SIDE = 2000  # of photos in which features are looked for, pixels
_FEWEST = 3
_EXHAUSTIVE = 150
"""Photos up to which every pair is compared; beyond, each with the next ones (photos of a walk or a video)."""

_FOLLOWERS = 15

USUAL_RANGE = 100.0
"""Range, metres, that the thresholds of KISS-ICP are made for: scans of another are brought to it, and the path back.
Its voxels are then a metre, a hundredth of the range, as it says itself."""


@dataclass(frozen=True)
class Structure:
    """What structure from motion made of a folder of photos.

    The folder holds a COLMAP model (binary) of the largest connected part; `train_from_colmap` takes it.
    """

    folder: Path
    photos: int
    photos_placed: int
    reprojection_error: float  # mean, pixels


def reconstruct(
    photos: str | os.PathLike[str],
    work_folder: str | os.PathLike[str],
    *,
    threads: int = -1,
    seed: int = 0,
    progress: Progress | None = None,
) -> Structure:
    """Find where photos were taken, and a sparse cloud of what they show.

    Incremental structure from motion of COLMAP (Schoenberger and Frahm 2016): SIFT, matching, mapping, all on the
    CPU. With one thread and a seed the result repeats; with more (-1: all), points come in another order.

    `photos` is a folder of at least three pictures that overlap; `work_folder`, made where missing, gets
    ``database.db`` and ``sparse/0``, and what an earlier run left there is replaced. All photos share one camera of one
    focal length, which makes the result steadier. Progress has the stages "features", "matches" and "mapping".
    """
    root, work = Path(photos), Path(work_folder)
    if not root.is_dir():
        raise InputError(f"{root}: is no folder of photos")
    names = sorted(p.name for p in root.iterdir() if p.suffix.lower() in PICTURES and p.is_file())
    if len(names) < _FEWEST:
        raise InputError(f"{root}: holds {len(names)} photos ({', '.join(PICTURES)}), at least {_FEWEST} needed")
    pycolmap = load_extra("pycolmap", "capture", "structure from motion")
    clock = Clock(progress)
    database, sparse = work / "database.db", work / "sparse"
    try:
        sparse.mkdir(parents=True, exist_ok=True)
        for left in (database, work / "database.db-wal", work / "database.db-shm"):
            left.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{work}: cannot be written: {error.strerror or error}") from None
    pycolmap.set_random_seed(seed)
    cpu = pycolmap.Device.cpu
    with clock.stage("features"):
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.num_threads, extraction.max_image_size, extraction.use_gpu = threads, _LONGEST_SIDE, False
        reader = pycolmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL")
        options = {"reader_options": reader, "extraction_options": extraction, "device": cpu}
        pycolmap.extract_features(database, root, image_names=names, camera_mode=pycolmap.CameraMode.SINGLE, **options)
    with clock.stage("matches"):
        matching = pycolmap.FeatureMatchingOptions()
        matching.num_threads, matching.use_gpu = threads, False
        if len(names) <= _EXHAUSTIVE:
            pycolmap.match_exhaustive(database, matching_options=matching, device=cpu)
        else:
            pairing = pycolmap.SequentialPairingOptions()
            pairing.overlap = _FOLLOWERS
            pycolmap.match_sequential(database, matching_options=matching, pairing_options=pairing, device=cpu)
    with clock.stage("mapping"):
        mapping = pycolmap.IncrementalPipelineOptions()
        mapping.num_threads, mapping.random_seed = threads, seed
        parts = pycolmap.incremental_mapping(database, root, sparse, mapping)
    if not parts:
        raise InputError(f"{root}: the {len(names)} photos do not hang together: no two of them could be placed")
    best = max(parts.values(), key=lambda part: (part.num_reg_images(), part.num_points3D()))
    folder = sparse / "0"
    folder.mkdir(exist_ok=True)
    best.write(folder)
    return Structure(folder, len(names), int(best.num_reg_images()), float(best.compute_mean_reprojection_error()))


def odometry(scans: Sequence[Scan]) -> Trajectory:
    """Where the scanner was at each scan, in the frame of the first, by KISS-ICP (Vizzo et al. 2023).

    At least two scans come in the order in which they were taken, each overlapping the one before. Where their points
    have times, the motion during a turn is undone; the path has times where all scans do. Ranges beyond the largest of
    the first scan are not used.
    """
    from engine.numerics.similarity import rotation_to_quaternion  # scipy: the command line only passes by

    if len(scans) < 2:
        raise InputError(f"odometry needs at least two scans, got {len(scans)}")
    kiss = load_extra("kiss_icp.kiss_icp", "capture", "LiDAR odometry")
    reach = float(np.linalg.norm(scans[0].cloud.points, axis=1).max(initial=0.0))
    if not (np.isfinite(reach) and reach > 0.0):
        raise InputError(f"the first scan reaches {reach}, expected a positive range")
    scale = USUAL_RANGE / reach
    config = load_extra("kiss_icp.config", "capture", "LiDAR odometry").KISSConfig()
    config.data.max_range, config.data.min_range = USUAL_RANGE, 0.0
    config.data.deskew = all(scan.cloud.times is not None for scan in scans)
    config.mapping.voxel_size = 0.01 * USUAL_RANGE
    config.registration.max_num_threads = 1  # the same bytes on every machine
    machine = kiss.KissICP(config)
    poses = []
    for scan in scans:
        inside = np.linalg.norm(scan.cloud.points, axis=1) <= reach
        if not inside.any():
            raise InputError(f"scan {scan.name!r} holds no points within {reach:g}")
        machine.register_frame(scan.cloud.points[inside] * scale, _turn(scan, inside))
        poses.append(np.asarray(machine.last_pose, dtype=np.float64).copy())
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
