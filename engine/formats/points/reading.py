"""Any file with points in it, told by its first bytes and not by its name."""

import os
from pathlib import Path

from engine.errors import FormatError, InputError, UnsupportedFormatError
from engine.formats.points.cloud import PointCloud
from engine.formats.points.las import looks_like_las, read_points_las
from engine.formats.points.pcd import looks_like_pcd, read_points_pcd
from engine.formats.points.ply import read_points_ply
from engine.formats.repairs import Repair

__all__ = ["POINT_ENDINGS", "read_point_cloud"]

POINT_ENDINGS = (".ply", ".pcd", ".las")


def read_point_cloud(
    path_or_bytes: str | os.PathLike[str] | bytes | bytearray | memoryview, *, name: str | None = None
) -> tuple[PointCloud, tuple[Repair, ...]]:
    """Read a point cloud: PLY, PCD or LAS.

    Parameters
    ----------
    path_or_bytes : path or bytes-like
        A file, or the content of one.
    name : str, optional
        What to call the input in messages; the path by default. Never opened.

    Returns
    -------
    cloud : PointCloud
    repairs : tuple of Repair
        Harmless faults that were mended.

    Raises
    ------
    FormatError
        The file cannot be read; the message names file, element, row and property.
    UnsupportedFormatError
        It is of none of these formats, LAZ, or a Gaussian model already.
    InputError
        There is no such file, or it may not be opened.
    """
    if isinstance(path_or_bytes, bytes | bytearray | memoryview):
        return _decode(bytes(path_or_bytes), name or "(bytes)")
    path = Path(path_or_bytes)
    file = name or str(path)
    if "\0" in str(path):
        raise InputError(f"{file!r}: is no file name")
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{file}: is no regular file")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from None
    return _decode(data, file)


def _decode(data: bytes, file: str) -> tuple[PointCloud, tuple[Repair, ...]]:
    try:
        if data.startswith((b"ply\n", b"ply\r")):
            return read_points_ply(data, file=file)
        if looks_like_pcd(data):
            return read_points_pcd(data, file=file)
        if looks_like_las(data):
            return read_points_las(data, file=file)
    except MemoryError:
        raise FormatError(f"needs more memory than there is ({len(data)} bytes)", file=file) from None
    if not data:
        raise FormatError("is empty", file=file)
    raise UnsupportedFormatError("is none of the point clouds read here: PLY, PCD, LAS", file=file)
