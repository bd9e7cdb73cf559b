"""Places from which a scenario looks at a scene."""

import numpy as np

from engine.model import Camera, look_at
from engine.pipeline.rigs import FIELD_OF_VIEW, UP, Extent

__all__ = ["viewpoint"]

MARGIN = 1.3
"""Distance at which the robust sphere just fits, times this: what lies outside the sphere wants room too."""


def viewpoint(extent: Extent, azimuth: float, elevation: float, width: int, height: int) -> Camera:
    """Camera on an orbit around a scene, or in the middle of a room looking out; angles in degrees."""
    a, e = np.radians(azimuth), np.radians(elevation)
    toward = np.array([np.cos(a), 0.0, np.sin(a)]) * np.cos(e) + UP * np.sin(e)
    focal = width / (2.0 * np.tan(FIELD_OF_VIEW / 2.0))
    if extent.is_room:
        return look_at(extent.center, extent.center + extent.radius * toward, UP, focal, width, height)
    away = MARGIN * extent.radius / np.sin(np.arctan(min(width, height) / (2.0 * focal)))
    return look_at(extent.center + away * toward, extent.center, UP, focal, width, height)
