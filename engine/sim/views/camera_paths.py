"""Camera paths for films, from the model alone: around it, and through it."""

import numpy as np

from engine.errors import InputError
from engine.model import Camera, Float64, GaussianModel, look_at
from engine.pipeline.rigs import FIELD_OF_VIEW, UP, Extent, direction, measure_extent

__all__ = ["fly_through", "orbit"]

ELEVATION = 22.0
"""Of an orbit, degrees."""
MARGIN = 1.25
"""Distance at which the robust sphere just fits the frame, times this: a tenth of the model lies beyond it."""


def orbit(model: GaussianModel, count: int, width: int, height: int, *, extent: Extent | None = None) -> list[Camera]:
    """Once around an object, or once round on the spot in the middle of a room; a film of it loops.

    Parameters
    ----------
    count : int
        Number of cameras, at least 1.
    width, height : int
        Pixels.
    extent : Extent, optional
        Where the model is, when already measured.

    Raises
    ------
    InputError
        If `count` is not positive.
    """
    extent = extent or measure_extent(model)
    turns = np.arange(_checked(count)) / count
    if extent.is_room:
        ways = [direction(a, 0.0) for a in 2 * np.pi * turns]
        return [_inside(extent, extent.center, way, width, height) for way in ways]
    away = _fitting_distance(extent, width, height)
    ways = [direction(a, np.radians(ELEVATION)) for a in 2 * np.pi * turns]
    return [_outside(extent, extent.center + away * way, width, height) for way in ways]


def fly_through(
    model: GaussianModel, count: int, width: int, height: int, *, extent: Extent | None = None
) -> list[Camera]:
    """One flight that speeds up and slows down: towards an object on a falling arc, or along a room.

    Parameters
    ----------
    count : int
        Number of cameras, at least 1.
    width, height : int
        Pixels.
    extent : Extent, optional
        Where the model is, when already measured.

    Raises
    ------
    InputError
        If `count` is not positive.
    """
    extent = extent or measure_extent(model)
    t = np.linspace(0.0, 1.0, _checked(count))
    cameras = []
    for s in t * t * (3.0 - 2.0 * t):
        if extent.is_room:
            along = direction(0.0 if extent.axes[0] >= extent.axes[2] else np.pi / 2, 0.0)
            reach = 0.3 * max(extent.axes[0], extent.axes[2])
            look = np.arctan2(along[2], along[0]) + np.radians(-40.0 + 80.0 * s)
            eye = extent.center + reach * (2 * s - 1) * along
            cameras.append(_inside(extent, eye, direction(look, 0.0), width, height))
        else:
            way = direction(np.radians(-60.0 + 150.0 * s), np.radians(45.0 - 27.0 * s))
            away = _fitting_distance(extent, width, height) * (1.3 - 0.75 * s)
            cameras.append(_outside(extent, extent.center + away * way, width, height))
    return cameras


def _checked(count: int) -> int:
    if count < 1:
        raise InputError(f"a camera path needs at least one camera, got {count}")
    return count


def _focal(width: int) -> float:
    return float(width / (2.0 * np.tan(FIELD_OF_VIEW / 2.0)))


def _fitting_distance(extent: Extent, width: int, height: int) -> float:
    half_angle = np.arctan(min(width, height) / (2.0 * _focal(width)))
    return float(MARGIN * extent.radius / np.sin(half_angle))


def _outside(extent: Extent, eye: Float64, width: int, height: int) -> Camera:
    return look_at(eye, extent.center, UP, _focal(width), width, height)


def _inside(extent: Extent, eye: Float64, toward: Float64, width: int, height: int) -> Camera:
    return look_at(eye, eye + extent.radius * toward, UP, _focal(width), width, height)
