"""A COLMAP reconstruction: its photos' cameras and its sparse points (https://colmap.github.io/format.html)."""

import math
import os
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, InputError
from engine.formats.cameras.colmap import PosedPhoto, read_photos
from engine.formats.cameras.files import SUBFOLDERS, read_limited
from engine.model import Float64

_ROW = struct.Struct("<Q3d3BdQ")
"""Id, position, color, reprojection error, length of the track; the track follows, 8 bytes an entry."""

_LARGEST = 1e15  # scene units; also false for what is no number


@dataclass(frozen=True, eq=False)
class ColmapPoints:
    """The sparse points of a reconstruction: places (N, 3) float64, scene units, finite; and colors (N, 3)."""

    positions: Float64
    colors: npt.NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.positions)


_Row = tuple[float, float, float, int, int, int, float]
"""Position, color, reprojection error."""


def read_points(data: bytes, file: str, *, binary: bool) -> ColmapPoints:
    """Points of a points3D file, in its order; there may be none.

    FormatError if it ends early, goes on too long, claims more points than its bytes can hold, or a row is no point.
    """
    rows = (_binary_rows if binary else _text_rows)(data, file)
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)  # (N, 7)
    return ColmapPoints(np.ascontiguousarray(table[:, :3]), table[:, 3:6].astype(np.uint8))


def _checked(row: _Row, file: str, number: int) -> _Row:
    if not all(abs(value) < _LARGEST for value in row[:3]):
        raise FormatError(f"the position {row[:3]} is not finite", file=file, row=number)
    if not all(0 <= value <= 255 for value in row[3:6]):
        raise FormatError(f"the color {row[3:6]} is not in 0..255", file=file, row=number)
    if not math.isfinite(row[6]):
        raise FormatError(f"the error {row[6]} is not finite", file=file, row=number)
    return row


def _text_rows(data: bytes, file: str) -> list[_Row]:
    rows: list[_Row] = []
    for line in data.decode("utf-8", "replace").splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < 8 or len(words) % 2:
            message = f"{len(words)} words are no point (id, x, y, z, r, g, b, error, pairs of image and point)"
            raise FormatError(message, file=file, row=len(rows))
        try:
            x, y, z, error = (float(words[k]) for k in (1, 2, 3, 7))
            r, g, b = (int(words[k]) for k in (4, 5, 6))
        except ValueError:
            raise FormatError(f"{line[:80]!r} is no point", file=file, row=len(rows)) from None
        rows.append(_checked((x, y, z, r, g, b, error), file, len(rows)))
    return rows


def _binary_rows(data: bytes, file: str) -> list[_Row]:
    if len(data) < 8:
        raise FormatError(f"has {len(data)} bytes, too few for a count", file=file)
    (count,) = struct.unpack_from("<Q", data)
    if count * _ROW.size > len(data) - 8:
        raise FormatError(f"claims {count} points in {len(data)} bytes", file=file)
    rows: list[_Row] = []
    at = 8
    for number in range(count):
        if at + _ROW.size > len(data):
            raise FormatError(f"ends after {len(data)} bytes, in the middle of a point", file=file, row=number)
        _, x, y, z, r, g, b, error, track = _ROW.unpack_from(data, at)
        at += _ROW.size
        if 8 * track > len(data) - at:
            raise FormatError(f"claims a track of {track} photos beyond the end", file=file, row=number)
        at += 8 * track
        rows.append(_checked((x, y, z, r, g, b, error), file, number))
    if at != len(data):
        raise FormatError(f"goes on for {len(data) - at} bytes after its last point", file=file)
    return rows


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
