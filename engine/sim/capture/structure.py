"""Structure from motion: from photos alone to a COLMAP model (extra ``capture``: pycolmap)."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from engine.errors import InputError
from engine.pipeline.progress import Clock, Progress
from engine.sim.capture.extras import load_extra

__all__ = ["Structure", "reconstruct"]

PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp")
_FEWEST = 3
_EXHAUSTIVE = 150
"""Photos up to which every pair is compared; beyond, each with the next ones (photos of a walk or a video)."""

_FOLLOWERS = 15


@dataclass(frozen=True)
class Structure:
    """What structure from motion made of a folder of photos.

    The folder holds a COLMAP model (binary) of the largest part that hangs together; `train_from_colmap` takes it. The
    report: photos, photos placed, points, mean reprojection error (pixels), mean track length, parts, seconds.
    """

    folder: Path
    report: dict[str, Any]


def reconstruct(
    photos: str | os.PathLike[str],
    work_folder: str | os.PathLike[str],
    *,
    one_camera: bool = True,
    size: int = 2000,
    threads: int = -1,
    seed: int = 0,
    progress: Progress | None = None,
) -> Structure:
    """Find where photos were taken, and a sparse cloud of what they show.

    Incremental structure from motion of COLMAP (Schoenberger and Frahm 2016): SIFT, matching, mapping, all on the
    CPU. With one thread and a seed the result repeats; with more, points come in another order.

    Parameters
    ----------
    photos : path
        Folder of pictures, at least three that overlap.
    work_folder : path
        Made where missing; gets ``database.db`` and ``sparse/0``. What an earlier run left there is replaced.
    one_camera : bool
        All photos by one camera at one focal length: steadier. False: each its own.
    size : int
        Longest side at which features are looked for, pixels.
    threads : int
        -1: all.
    progress : callable, optional
        Stages "features", "matches" and "mapping".
    """
    root, work = Path(photos), Path(work_folder)
    if not root.is_dir():
        raise InputError(f"{root}: is no folder of photos")
    names = sorted(p.name for p in root.iterdir() if p.suffix.lower() in PICTURES and p.is_file())
    if len(names) < _FEWEST:
        raise InputError(f"{root}: holds {len(names)} photos ({', '.join(PICTURES)}), at least {_FEWEST} needed")
    pycolmap = load_extra("pycolmap", "pycolmap", "structure from motion")
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
        extraction.num_threads, extraction.max_image_size, extraction.use_gpu = threads, size, False
        mode = pycolmap.CameraMode.SINGLE if one_camera else pycolmap.CameraMode.PER_IMAGE
        reader = pycolmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL")
        options = {"reader_options": reader, "extraction_options": extraction, "device": cpu}
        pycolmap.extract_features(database, root, image_names=names, camera_mode=mode, **options)
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
    report = {
        "photos": len(names),
        "photos_placed": int(best.num_reg_images()),
        "points": int(best.num_points3D()),
        "reprojection_error": float(best.compute_mean_reprojection_error()),
        "track_length": float(best.compute_mean_track_length()),
        "parts": len(parts),
        "seconds_by_stage": clock.seconds,
    }
    return Structure(folder, report)
