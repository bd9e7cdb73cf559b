"""What the columns of a point file mean: the names that scanners and programs give to the same things."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError
from engine.formats.repairs import Repair
from engine.lab.points.cloud import PointCloud, clean_points, unit_colors
from engine.model import Float32

__all__ = ["cloud_of_columns"]

Columns = Mapping[str, npt.NDArray[Any]]

_COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_INTENSITIES = ("intensity", "scalar_intensity", "scalar_Intensity", "reflectivity", "reflectance", "i")
_TIMES = ("time", "timestamp", "time_stamp", "gps_time", "GpsTime", "scalar_GpsTime", "t")

NANOSECONDS = 1e-9
"""Devices count whole nanoseconds; only stamps in floating point are seconds."""


def cloud_of_columns(columns: Columns, *, file: str, element: str) -> tuple[PointCloud, tuple[Repair, ...]]:
    """A cloud out of named columns (N,) (PLY, PCD) of any scalar type and byte order.

    Places are ``x``, ``y``, ``z``; colours ``red``, ``green``, ``blue`` (or ``r``, ``g``, ``b``, ``diffuse_red`` ...:
    whole numbers of the type's full range, or 0 to 1, or 0 to 255) or ``rgb`` / ``rgba`` (0xRRGGBB in an integer or in
    the bits of a float, as PCL writes them). Times are ``time``, ``timestamp``, ``gps_time``, ``t``: seconds,
    nanoseconds where they are whole numbers.

    FormatError if a column of the place is missing, colours are not of one type, or no point is usable.
    """
    for name in "xyz":
        if name not in columns:
            raise FormatError("is missing", file=file, element=element, prop=name)
    with np.errstate(over="ignore", invalid="ignore"):
        points = np.stack([columns[name].astype(np.float64) for name in "xyz"], axis=1)  # (N, 3)
    colors, noted = _colors(columns, file, element)
    intensity = next((columns[name] for name in _INTENSITIES if name in columns), None)
    times = next((columns[name] for name in _TIMES if name in columns), None)
    if times is not None and times.dtype.kind in "iu":
        times = times.astype(np.float64) * NANOSECONDS
    cloud, repairs = clean_points(points, colors, intensity, times, file=file, element=element)
    return cloud, noted + repairs


def _colors(columns: Columns, file: str, element: str) -> tuple[Float32 | None, tuple[Repair, ...]]:
    for packed in ("rgb", "rgba"):
        if packed in columns:
            return _unpacked(columns[packed], packed, file, element), ()
    names = next((names for names in _COLORS if all(name in columns for name in names)), None)
    if names is None:
        return None, ()
    kinds = {columns[name].dtype.newbyteorder("=") for name in names}
    if len(kinds) > 1:
        message = f"colours of different types: {', '.join(sorted(kind.name for kind in kinds))}"
        raise FormatError(message, file=file, element=element, prop=names[0])
    kind = kinds.pop()
    raw = np.stack([columns[name] for name in names], axis=1)  # (N, 3)
    if kind.kind in "iu":
        return unit_colors(raw, 255.0 if kind.itemsize == 1 else float(np.iinfo(kind).max)), ()
    with np.errstate(invalid="ignore"):
        if bool((np.isfinite(raw) & (raw > 1.0)).any()):
            text = "colours in floating point go beyond 1: taken as 0 to 255"
            return unit_colors(raw, 255.0), (Repair("colors_scaled", len(raw), text),)
    return unit_colors(raw, 1.0), ()


def _unpacked(raw: npt.NDArray[Any], name: str, file: str, element: str) -> Float32:
    """(N, 3) colours of 0xRRGGBB; the bits of a float32 are the integer (PCL)."""
    native = raw.astype(raw.dtype.newbyteorder("="))
    if native.dtype.itemsize != 4:
        message = f"packed colours have 4 bytes, not {native.dtype.itemsize}"
        raise FormatError(message, file=file, element=element, prop=name)
    bits = native.view(np.uint32)
    return unit_colors(np.stack([(bits >> shift) & 255 for shift in (16, 8, 0)], axis=1), 255.0)
