"""Point clouds as PLY, binary of either byte order or ASCII; meshes give their vertices."""

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.ply.body import read_tables
from engine.formats.ply.header import parse_header
from engine.formats.points.cloud import PointCloud
from engine.formats.points.columns import cloud_of_columns
from engine.formats.repairs import Repair

__all__ = ["read_points_ply"]


def read_points_ply(data: bytes | memoryview, *, file: str) -> tuple[PointCloud, tuple[Repair, ...]]:
    """Read the vertices of a PLY file.

    Parameters
    ----------
    data : bytes-like
        The whole file.
    file : str
        Name, for messages.

    Returns
    -------
    cloud : PointCloud
    repairs : tuple of Repair

    Raises
    ------
    FormatError
        The bytes are not what the header says, or places are missing.
    UnsupportedFormatError
        The file is a Gaussian model already.
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
