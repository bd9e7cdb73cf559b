"""A cloud of points, whatever device or program it came from; and what is mended when one is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, InputError
from engine.formats.repairs import MAGNITUDE_LIMIT, Repair
from engine.model import Float32, Float64

__all__ = ["PointCloud", "clean_points", "unit_colors"]


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
    """(N, 3) colours 0 to 1 of stored ones in 0 to full; beyond either end they are clipped, NaN is black."""
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
    """Turn decoded columns into a cloud that every later stage may trust, in the order of the file; and tell what was
    mended.

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
