"""Point clouds as LAS 1.2 to 1.4, point formats 0 to 10 (ASPRS LAS Specification 1.4 R15)."""

import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.repairs import Repair
from engine.lab.points.cloud import PointCloud, clean_points, unit_colors
from engine.model import Bool, Float64

__all__ = ["looks_like_las", "read_points_las"]

_HEADER_SIZES = {2: 227, 3: 235, 4: 375}
"""Minor version -> bytes of the header."""

_RECORD_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
_TIME_AT = {1: 20, 3: 20, 4: 20, 5: 20, 6: 22, 7: 22, 8: 22, 9: 22, 10: 22}
_COLOR_AT = {2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30}
_COMPRESSED = 0xC0
"""Bits that LASzip sets in the point format; no LAS file has them."""

_NOISE = (7, 18)
"""Classes "low point (noise)" and "high noise"."""

_ELEMENT = "points"


@dataclass(frozen=True)
class _LasHeader:
    format: int
    stride: int
    offset: int
    count: int
    scales: tuple[float, float, float]
    origin: tuple[float, float, float]


def looks_like_las(data: bytes | memoryview) -> bool:
    """Whether the file starts as LAS and LAZ files do."""
    return bytes(data[:4]) == b"LASF"


def read_points_las(data: bytes | memoryview, *, file: str) -> tuple[PointCloud, tuple[Repair, ...]]:
    """Read a LAS file: coordinates with the header's scale and offset, times as stored (GPS seconds).

    Points that the file itself calls noise (classes 7, 18) or withheld are left out. Colours are of 16 bits; where none
    is above 255, the writer kept to 8. Near-infrared and waveforms are not read. FormatError if the bytes are not what
    the header says, UnsupportedFormatError for LAZ, another version, or a point format beyond 10.
    """
    header = _parse_header(data, file)
    fields = {"place": ("<i4", (3,), 0), "intensity": ("<u2", (), 12), "flags": ("u1", (), 15), "class": ("u1", (), 16)}
    if header.format in _TIME_AT:
        fields["time"] = ("<f8", (), _TIME_AT[header.format])
    if header.format in _COLOR_AT:
        fields["color"] = ("<u2", (3,), _COLOR_AT[header.format])
    layout = np.dtype(
        {
            "names": list(fields),
            "formats": [(kind, shape) for kind, shape, _ in fields.values()],
            "offsets": [at for _, _, at in fields.values()],
            "itemsize": header.stride,
        }
    )
    records = np.frombuffer(data, layout, header.count, header.offset)
    repairs: list[Repair] = []
    left_out = _left_out(records, header.format)
    if left_out.any():
        lost = int(np.count_nonzero(left_out))
        if lost == len(records):
            raise FormatError(f"all {lost} points are noise or withheld", file=file, element=_ELEMENT)
        repairs.append(Repair("noise_dropped", lost, f"{lost} points left out: the file calls them noise"))
        records = records[~left_out]
    with np.errstate(over="ignore", invalid="ignore"):
        points: Float64 = records["place"] * np.array(header.scales) + np.array(header.origin)
    colors = None
    if "color" in fields and records["color"].any():  # all black: a format with colours, a scanner without
        eight_bits = int(records["color"].max()) <= 255
        if eight_bits:
            text = "colours of 16 bits do not go beyond 255: taken as 8 bits"
            repairs.append(Repair("colors_scaled", len(records), text))
        colors = unit_colors(records["color"], 255.0 if eight_bits else 65535.0)
    times = records["time"] if "time" in fields else None
    cloud, mended = clean_points(points, colors, records["intensity"], times, file=file, element=_ELEMENT)
    return cloud, (*repairs, *mended)


def _left_out(records: npt.NDArray[np.void], format: int) -> Bool:
    """(N,) points that are noise or withheld; formats 0 to 5 keep class and flags in one byte."""
    if format <= 5:
        return np.isin(records["flags"] & 31, _NOISE) | (records["flags"] >= 128)
    return np.isin(records["class"], _NOISE) | (records["flags"] & 4 > 0)


def _parse_header(data: bytes | memoryview, file: str) -> _LasHeader:
    """The header, once it is known that all points it announces are there."""
    if len(data) < _HEADER_SIZES[2]:
        raise FormatError(f"has {len(data)} bytes, too few for a LAS header", file=file)
    if not looks_like_las(data):
        raise FormatError("is no LAS file: it does not start with 'LASF'", file=file)
    major, minor, header_size, offset, variables, format, stride, count = (
        *struct.unpack_from("<BB", data, 24),
        *struct.unpack_from("<HIIBHI", data, 94),
    )
    _refuse_unread(major, minor, format, stride, file)
    if header_size < _HEADER_SIZES[minor] or header_size > len(data):
        message = f"the header says it has {header_size} bytes, LAS 1.{minor} has {_HEADER_SIZES[minor]}"
        raise FormatError(message, file=file)
    if offset < header_size + 54 * variables:  # 54 bytes: the head of a variable length record
        raise FormatError(f"points start at byte {offset}, inside the header and its {variables} records", file=file)
    count = _announced(data, minor, count, file)
    if count == 0:
        raise FormatError("holds no points", file=file, element=_ELEMENT)
    there = max(len(data) - offset, 0)
    if count * stride > there:
        message = f"the header announces {count} points of {stride} bytes, but only {there} bytes are there"
        raise FormatError(message, file=file, element=_ELEMENT, row=there // stride)
    beyond = there - count * stride
    if beyond and not _may_go_on(data, minor):
        raise FormatError(f"{beyond} bytes follow the {count} points: the count is wrong", file=file, element=_ELEMENT)
    scales, origin = struct.unpack_from("<3d", data, 131), struct.unpack_from("<3d", data, 155)
    if not (np.isfinite([*scales, *origin]).all() and all(scales)):
        raise FormatError(f"scale {scales} and offset {origin} of the coordinates", file=file)
    return _LasHeader(format, stride, offset, count, scales, origin)


def _refuse_unread(major: int, minor: int, format: int, stride: int, file: str) -> None:
    """Raise for versions and point formats that are not read here."""
    if major != 1 or minor not in _HEADER_SIZES:
        raise UnsupportedFormatError(f"LAS {major}.{minor} is not read here, only 1.2 to 1.4", file=file)
    if format & _COMPRESSED:
        message = "is LAZ (compressed LAS), which is not read here; unpack it with 'laszip' or PDAL to .las"
        raise UnsupportedFormatError(message, file=file)
    if format >= len(_RECORD_SIZES):
        raise UnsupportedFormatError(f"point format {format} is not read here, only 0 to 10", file=file)
    if stride < _RECORD_SIZES[format]:
        message = f"point format {format} has {_RECORD_SIZES[format]} bytes a point, the header says {stride}"
        raise FormatError(message, file=file, element=_ELEMENT)


def _announced(data: bytes | memoryview, minor: int, count: int, file: str) -> int:
    """Points the header announces; LAS 1.4 counts them in 64 bits too."""
    if minor != 4:
        return count
    (wide,) = struct.unpack_from("<Q", data, 247)
    if wide and count and wide != count:
        raise FormatError(f"announces {count} points and {wide} points", file=file, element=_ELEMENT)
    return int(wide or count)


def _may_go_on(data: bytes | memoryview, minor: int) -> bool:
    """Whether waveforms (1.3) or extended records (1.4) are announced behind the points."""
    if minor == 2:
        return False
    waveforms = struct.unpack_from("<Q", data, 227)[0]
    return bool(waveforms or (minor == 4 and struct.unpack_from("<I", data, 243)[0]))
