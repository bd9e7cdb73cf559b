"""A COLMAP reconstruction as a whole: its photos' cameras and its sparse points."""

import os
from dataclasses import dataclass
from pathlib import Path

from engine.errors import InputError
from engine.formats.cameras.colmap import PosedPhoto, read_photos
from engine.formats.cameras.files import SUBFOLDERS, read_limited
from engine.lab.points.colmap import ColmapPoints, read_points

__all__ = ["Reconstruction", "read_reconstruction"]


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """What structure from motion found: photos in the order of their names, and sparse points."""

    photos: list[PosedPhoto]
    points: ColmapPoints


def read_reconstruction(path: str | os.PathLike[str]) -> Reconstruction:
    """Read a COLMAP model: ``cameras``, ``images`` and ``points3D`` (``.bin`` or ``.txt``) in a folder, or below it
    under a usual name (``sparse/0``).

    InputError if there is no such folder or file; CameraError or FormatError if one is broken, naming it and the entry.
    """
    root = Path(path)
    for folder in (root / name for name in SUBFOLDERS):
        for suffix in (".bin", ".txt"):
            files = [folder / f"{name}{suffix}" for name in ("cameras", "images", "points3D")]
            if all(file.is_file() for file in files):
                return _read(files, binary=suffix == ".bin")
    raise InputError(f"{root}: holds no COLMAP model: cameras, images and points3D, all .bin or all .txt")


def _read(files: list[Path], *, binary: bool) -> Reconstruction:
    try:
        cameras, images, points = (read_limited(file) for file in files)
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror or error}") from None
    return Reconstruction(
        read_photos(cameras, images, str(files[0]), str(files[1]), binary=binary),
        read_points(points, str(files[2]), binary=binary),
    )
