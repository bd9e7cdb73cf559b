"""Point clouds as LAS and LAZ, read by laspy (ASPRS LAS Specification 1.4 R15)."""

import io
import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from engine.errors import FormatError, UnsupportedFormatError
from engine.extras import load_extra
from engine.formats.guards import FREE_COUNT
from engine.formats.repairs import Repair
from engine.lab.points.cloud import PointCloud, clean_points, unit_colors
from engine.model import Float64

_HEADER_BYTES = 227  # bytes of the shortest header, that of LAS 1.0 to 1.2
_RECORD_HEAD = 54  # bytes before the content of a variable length record

_LAZ_GROWTH = 100
"""Largest size of the unpacked points over that of the file,
beyond FREE_COUNT points; LAZ packs scans 4 to 15 times."""

_LAZ_MEMORY = 1 << 29  # bytes that unpacking may use beyond three times the points
_NOISE = (7, 18)  # classes "low point (noise)" and "high noise"

_ELEMENT = "points"


def looks_like_las(data: bytes | memoryview) -> bool:
    """Whether the file starts as LAS and LAZ files do."""
    return bytes(data[:4]) == b"LASF"


def read_points_las(data: bytes, *, file: str) -> tuple[PointCloud, tuple[Repair, ...]]:
    """Read a LAS or LAZ file: coordinates with the header's scale and offset, times as stored (GPS seconds).

    Points that the file itself calls noise (classes 7, 18) or withheld are left out. Colors have 16 bits; where none is
    above 255, the writer used 8 bits. Near-infrared and waveforms are not read. FormatError if the bytes are not what
    the header says, UnsupportedFormatError for a version or point format that laspy does not read, InputError if laspy
    (or, for LAZ, lazrs) is not installed.
    """
    _check_layout(data, file)
    laspy = load_extra("laspy", "capture", "reading LAS")
    try:
        reader = laspy.LasReader(io.BytesIO(data), read_evlrs=False)
    except Exception as error:  # laspy has no check of its own for most broken headers
        kind = UnsupportedFormatError if "support" in type(error).__name__.lower() else FormatError
        raise kind(f"the LAS header cannot be read: {str(error)[:200]}", file=file) from None
    _check_count(reader.header, len(data), file)
    if reader.header.are_points_compressed:
        stored = laspy.PackedPointRecord.from_buffer(_unpacked(data, reader.header, file), reader.header.point_format)
    else:
        stored = reader.read_points(-1)
    return _cloud(stored, reader.header, file)


def _unpacked(data: bytes, header: Any, file: str) -> bytes:
    """The point records of a LAZ file."""
    load_extra("lazrs", "capture", "reading LAZ (compressed LAS)")
    size = header.point_count * header.point_format.size
    program = [sys.executable, str(Path(__file__).with_name("laz_process.py")), str(_LAZ_MEMORY + 3 * size)]
    done = subprocess.run(program, input=data, capture_output=True, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"})
    if done.returncode or len(done.stdout) != size:
        reason = done.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2] or f"exit {done.returncode}"
        raise FormatError(f"the points cannot be unpacked: {reason[:200]}", file=file, element=_ELEMENT)
    return done.stdout


def _cloud(stored: Any, header: Any, file: str) -> tuple[PointCloud, tuple[Repair, ...]]:
    """The cloud of laspy's points."""
    repairs: list[Repair] = []
    left_out = np.isin(np.asarray(stored.classification), _NOISE) | np.asarray(stored.withheld, dtype=bool)
    if left_out.any():
        lost = int(np.count_nonzero(left_out))
        if lost == len(stored):
            raise FormatError(f"all {lost} points are noise or withheld", file=file, element=_ELEMENT)
        repairs.append(Repair("noise_dropped", lost, f"{lost} points left out: the file calls them noise"))
        stored = stored[~left_out]
    with np.errstate(over="ignore", invalid="ignore"):
        points: Float64 = np.stack([stored.X, stored.Y, stored.Z], axis=1) * header.scales + header.offsets  # (N, 3)
    names = set(header.point_format.dimension_names)
    colors = None
    raw = np.stack([stored.red, stored.green, stored.blue], axis=1) if "red" in names else None
    if raw is not None and raw.any():  # all black: a format with colors, a scanner without
        eight_bits = int(raw.max()) <= 255
        if eight_bits:
            repairs.append(
                Repair("colors_scaled", len(raw), "16-bit colors do not go beyond 255: taken as 8-bit colors")
            )
        colors = unit_colors(raw, 255.0 if eight_bits else 65535.0)
    times = np.asarray(stored.gps_time) if "gps_time" in names else None
    cloud, mended = clean_points(points, colors, np.asarray(stored.intensity), times, file=file, element=_ELEMENT)
    return cloud, (*repairs, *mended)


def _check_layout(data: bytes, file: str) -> None:
    """Refuse a header whose records or points lie outside the file, before laspy follows it."""
    if len(data) < _HEADER_BYTES:
        raise FormatError(f"has {len(data)} bytes, too few for a LAS header", file=file)
    header_size, offset, records = struct.unpack_from("<HII", data, 94)
    if offset < header_size + _RECORD_HEAD * records:
        raise FormatError(f"points start at byte {offset}, inside the header and its {records} records", file=file)
    if offset > len(data):
        raise FormatError(f"points start at byte {offset}, but the file has {len(data)} bytes", file=file)


def _check_count(header: Any, size: int, file: str) -> None:
    """Refuse a number of points that the file cannot hold, before anything is allocated for them."""
    count, stride, body = header.point_count, header.point_format.size, size - header.offset_to_point_data
    if count == 0:
        raise FormatError("holds no points", file=file, element=_ELEMENT)
    if header.are_points_compressed:
        if count > max(FREE_COUNT, _LAZ_GROWTH * size // stride):
            raise FormatError(f"the header announces {count} points in {size} bytes", file=file, element=_ELEMENT)
    elif count * stride > body:
        message = f"the header announces {count} points of {stride} bytes, but only {body} bytes are there"
        raise FormatError(message, file=file, element=_ELEMENT, row=body // stride)
    elif (beyond := body - count * stride) and not (
        header.start_of_waveform_data_packet_record or header.number_of_evlrs
    ):
        raise FormatError(f"{beyond} bytes follow the {count} points: the count is wrong", file=file, element=_ELEMENT)
    if not (np.isfinite([*header.scales, *header.offsets]).all() and all(header.scales)):
        message = f"scale {header.scales.tolist()} and offset {header.offsets.tolist()} of the coordinates"
        raise FormatError(message, file=file)
