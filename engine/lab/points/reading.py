"""Point cloud files, recognized by their first bytes and not by their names."""

import os
from pathlib import Path

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.guards import opening, read_regular
from engine.formats.ply.body import read_tables
from engine.formats.ply.header import parse_header
from engine.formats.repairs import Repair
from engine.lab.points.cloud import PointCloud, cloud_of_columns
from engine.lab.points.las import looks_like_las, read_points_las
from engine.lab.points.pcd import looks_like_pcd, read_points_pcd

POINT_ENDINGS = (".ply", ".pcd", ".las", ".laz")


def read_point_cloud(
    path_or_bytes: str | os.PathLike[str] | bytes | bytearray | memoryview, *, name: str | None = None
) -> tuple[PointCloud, tuple[Repair, ...]]:
    """Read a point cloud, PLY, PCD, LAS or LAZ, from a file or the content of oneand list what was repaired.

    `name` is what to call the input in messages, by default its path; it is never opened. FormatError if the file
    cannot be read, naming file, element, row and property; UnsupportedFormatError if it is of none of these formats, or
    a Gaussian model already; InputError if there is no such file, it may not be opened, or a package is missing.
    """
    if isinstance(path_or_bytes, bytes | bytearray | memoryview):
        return _decode(bytes(path_or_bytes), name or "(bytes)")
    path = Path(path_or_bytes)
    file = name or str(path)
    with opening(path, file):
        data = read_regular(path, file)
    return _decode(data, file)


def _decode(data: bytes, file: str) -> tuple[PointCloud, tuple[Repair, ...]]:
    try:
        if data.startswith((b"ply\n", b"ply\r")):
            return _read_ply(data, file=file)
        if looks_like_pcd(data):
            return read_points_pcd(data, file=file)
        if looks_like_las(data):
            return read_points_las(data, file=file)
    except MemoryError:
        raise FormatError(f"needs more memory than there is ({len(data)} bytes)", file=file) from None
    if not data:
        raise FormatError("is empty", file=file)
    raise UnsupportedFormatError("is none of the point clouds read here: PLY, PCD, LAS, LAZ", file=file)


def _read_ply(data: bytes | memoryview, *, file: str) -> tuple[PointCloud, tuple[Repair, ...]]:
    """The vertices of a PLY file, binary of either byte order or ASCII; a mesh is read, too.

    FormatError if the bytes are not what the header says, or places are missing; UnsupportedFormatError if the file is
    a Gaussian model already.
    """
    header = parse_header(data, file=file)
    vertex = header.element("vertex")
    if vertex is None:
        there = ", ".join(repr(e.name) for e in header.elements[:5])
        raise FormatError(f"has no element 'vertex', only {there}", file=file)
    if {"f_dc_0", "opacity"} <= vertex.names or "packed_position" in vertex.names:
        message = "is a Gaussian model, not a point cloud: it needs no conversion"
        raise UnsupportedFormatError(message, file=file, element="vertex")
    records = read_tables(data, header, ["vertex"], file=file)["vertex"]
    columns = {name: records[name] for name in vertex.names}
    return cloud_of_columns(columns, file=file, element="vertex")
