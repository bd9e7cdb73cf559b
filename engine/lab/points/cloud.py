"""A cloud of points from any device or program, what file columns mean, and what is repaired on reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, InputError
from engine.formats.repairs import MAGNITUDE_LIMIT, Repair
from engine.model import Float32, Float64


@dataclass(frozen=True, eq=False)
class PointCloud:
    """N points, with what their file knows of each; InputError if the arrays do not fit together."""

    points: Float64  # (N, 3) scene units, finite
    colors: Float32 | None = None  # (N, 3) range 0 to 1
    intensity: Float32 | None = None  # (N,) strength of the return, in the unit of the device, finite
    times: Float64 | None = None  # (N,) seconds, of the device's own clock, finite

    def __post_init__(self) -> None:
        n = len(self.points)
        shapes: dict[str, tuple[tuple[int, ...], Any]] = {
            "points": ((n, 3), np.float64),
            "colors": ((n, 3), np.float32),
            "intensity": ((n,), np.float32),
            "times": ((n,), np.float64),
        }
        for name, (shape, dtype) in shapes.items():
            value = getattr(self, name)
            if value is None:
                continue
            array = np.ascontiguousarray(value, dtype=dtype)
            if array.shape != shape:
                raise InputError(f"{name} has shape {array.shape}, expected {shape}")
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: npt.NDArray[Any]) -> PointCloud:
        """The points at an integer index or under a boolean mask, in that order."""
        optional = [None if a is None else a[index] for a in (self.colors, self.intensity, self.times)]
        return PointCloud(self.points[index], *optional)


def unit_colors(raw: npt.NDArray[Any], full: float) -> Float32:
    """(N, 3) colors 0 to 1 of stored ones in 0 to full; beyond either end they are clipped, NaN is black."""
    with np.errstate(invalid="ignore", over="ignore"):
        shades = np.clip(raw.astype(np.float32) / np.float32(full), 0.0, 1.0)
    return np.where(np.isnan(shades), np.float32(0.0), shades)


def clean_points(
    points: Float64,
    colors: Float32 | None,
    intensity: npt.NDArray[Any] | None,
    times: npt.NDArray[Any] | None,
    *,
    file: str,
    element: str,
) -> tuple[PointCloud, tuple[Repair, ...]]:
    """Turn decoded columns into a cloud that every later stage may trust, in the order of the file; and list what was
    repaired.

    `points` (N, 3) float64, `colors` (N, 3) float32 from 0 to 1, `intensity` and `times` (N,). Points without a finite
    place (devices write NaN where no light came back) are dropped; an intensity that is no number becomes 0; times with
    a gap are left out altogether, since a point without a time has no place. FormatError if there is no point, or none
    with a place.
    """
    if len(points) == 0:
        raise FormatError("holds no points", file=file, element=element)
    repairs: list[Repair] = []
    good = (np.abs(points) <= MAGNITUDE_LIMIT).all(axis=1)  # false for NaN as well
    if not good.any():
        raise FormatError(f"no point has a place: {points[0].tolist()}", file=file, element=element, row=0)
    lost = len(points) - int(np.count_nonzero(good))
    if lost:
        text = f"{lost} points (first in row {int(np.argmin(good))}) left out: they have no finite place"
        repairs.append(Repair("rows_dropped", lost, text))
        points = points[good]
        colors = None if colors is None else colors[good]
    with np.errstate(over="ignore", invalid="ignore"):
        strength = None if intensity is None else intensity[good].astype(np.float32)
        stamps = None if times is None else times[good].astype(np.float64)
    if strength is not None and not (finite := np.isfinite(strength)).all():
        bad = int(np.count_nonzero(~finite))
        repairs.append(Repair("intensity_missing", bad, f"{bad} intensities that are no number became 0"))
        strength = np.where(finite, strength, np.float32(0.0))
    if stamps is not None and not (finite := np.isfinite(stamps)).all():
        bad = int(np.count_nonzero(~finite))
        repairs.append(Repair("times_ignored", bad, f"times ignored: {bad} of them are no number"))
        stamps = None
    return PointCloud(points, colors, strength, stamps), tuple(repairs)


Columns = Mapping[str, npt.NDArray[Any]]

_COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_INTENSITIES = ("intensity", "scalar_intensity", "scalar_Intensity", "reflectivity", "reflectance", "i")
_TIMES = ("time", "timestamp", "time_stamp", "gps_time", "GpsTime", "scalar_GpsTime", "t")

NANOSECONDS = 1e-9  # devices count whole nanoseconds; only stamps in floating point are seconds


def cloud_of_columns(columns: Columns, *, file: str, element: str) -> tuple[PointCloud, tuple[Repair, ...]]:
    """A cloud out of named columns (N,) (PLY, PCD) of any scalar type and byte order.

    Places are ``x``, ``y``, ``z``; colors ``red``, ``green``, ``blue`` (or ``r``, ``g``, ``b``, ``diffuse_red`` ...:
    whole numbers of the type's full range, or 0 to 1, or 0 to 255) or ``rgb`` / ``rgba`` (0xRRGGBB in an integer or in
    the bits of a float, as PCL writes them). Times are ``time``, ``timestamp``, ``gps_time``, ``t``: seconds,
    nanoseconds where they are whole numbers.

    FormatError if a column of the place is missing, colors are not of one type, or no point is usable.
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
        message = f"colors of different types: {', '.join(sorted(kind.name for kind in kinds))}"
        raise FormatError(message, file=file, element=element, prop=names[0])
    kind = kinds.pop()
    raw = np.stack([columns[name] for name in names], axis=1)  # (N, 3)
    if kind.kind in "iu":
        return unit_colors(raw, 255.0 if kind.itemsize == 1 else float(np.iinfo(kind).max)), ()
    with np.errstate(invalid="ignore"):
        if bool((np.isfinite(raw) & (raw > 1.0)).any()):
            text = "colors in floating point go beyond 1: taken as 0 to 255"
            return unit_colors(raw, 255.0), (Repair("colors_scaled", len(raw), text),)
    return unit_colors(raw, 1.0), ()


def _unpacked(raw: npt.NDArray[Any], name: str, file: str, element: str) -> Float32:
    """(N, 3) colors of 0xRRGGBB; the bits of a float32 are the integer (PCL)."""
    native = raw.astype(raw.dtype.newbyteorder("="))
    if native.dtype.itemsize != 4:
        message = f"packed colors have 4 bytes, not {native.dtype.itemsize}"
        raise FormatError(message, file=file, element=element, prop=name)
    bits = native.view(np.uint32)
    return unit_colors(np.stack([(bits >> shift) & 255 for shift in (16, 8, 0)], axis=1), 255.0)
