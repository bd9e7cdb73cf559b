"""Camera rigs from the model alone (DESIGN 4.1): most models come without cameras.

An *object* (or a piece of ground seen from the air) is looked at from shells of orbits around it; a *room* is
looked at from inside. Which of the two is decided by where the Gaussians are: a room keeps its middle empty.
"""

from dataclasses import dataclass

import numpy as np

from engine.flows.views.config import CONFIG
from engine.model import Camera, Float64, GaussianModel, look_at

_CONFIG = CONFIG.rig
UP = np.array([0.0, -1.0, 0.0])
"""Captures are written with y pointing down (COLMAP, INRIA); only the roll of a generated view depends on it."""

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
"""Successive azimuths of a rig: any prefix of the rig covers the circle evenly."""


@dataclass(frozen=True)
class Extent:
    """Where a model is, robust against floaters."""

    center: Float64  # (3,) weighted median of the centres, scene units
    radius: float  # weighted 90 % quantile of the distance from the centre
    axes: Float64  # (3,) weighted 5 % to 95 % width along x, y, z
    is_room: bool  # the middle is empty and the walls are all around

    @property
    def lowest(self) -> float:
        """Elevation from which the lowest views look down, degrees."""
        upright = self.axes[1] > _CONFIG.flat * max(self.axes[0], self.axes[2])
        return _CONFIG.lowest if upright else _CONFIG.lowest_of_ground

    def fewer(self, views: int) -> int:
        """How many views do where so many are taken around what stands upright: ground is looked at from above alone,
        and half as densely."""
        if self.is_room or self.lowest == _CONFIG.lowest:
            return views
        least, lowest, highest = np.sin(np.radians([_CONFIG.lowest, self.lowest, _CONFIG.highest]))
        return int(np.ceil(_CONFIG.of_ground * views * (highest - lowest) / (highest - least)))


def _weighted_quantile(values: Float64, weights: Float64, q: float) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(cumulative, q * cumulative[-1])]])


def measure_extent(model: GaussianModel) -> Extent:
    """Robust centre, radius and kind of a model, from quantiles weighted by opacity times visible area."""
    means = model.means.astype(np.float64)
    log_area = np.sort(model.log_scales.astype(np.float64), axis=1)[:, 1:].sum(axis=1)
    # A handful of sky-sized Gaussians must not decide where the model is.
    area = np.exp(np.minimum(log_area, np.quantile(log_area, 0.95)) - log_area.max())
    weights = np.maximum(model.opacities.astype(np.float64) * area, 1e-300)
    low, center, high = (
        np.array([_weighted_quantile(means[:, d], weights, q) for d in range(3)]) for q in (0.05, 0.5, 0.95)
    )
    middle = 0.5 * (low + high)
    center = np.where(np.abs(center - middle) < 0.25 * (high - low), middle, center)
    distance = np.linalg.norm(means - center, axis=1)
    radius = max(_weighted_quantile(distance, weights, 0.9), 1e-6)
    inside = float(weights[distance < 0.45 * radius].sum() / weights.sum())
    return Extent(center, radius, np.maximum(high - low, 1e-9), len(model) > 100 and inside < _CONFIG.room_emptiness)


def make_rig(
    model: GaussianModel,
    count: int,
    width: int,
    height: int,
    *,
    jitter: Float64 | None = None,
    extent: Extent | None = None,
    elevations: tuple[float, float] | None = None,
) -> list[Camera]:
    """Views that show the whole model, evenly spread; the same model gives the same rig.

    Parameters
    ----------
    count : int
        Number of cameras.
    width, height : int
        Image size, pixels.
    jitter : (count, 4) in [0, 1), optional
        Moves azimuth, elevation, distance and aim; the pose key draws it from the owner's key, trials from a
        seed. Without it the rig is the plain, regular one.
    extent : Extent, optional
        Where the model is, when already measured.
    elevations : (2,), optional
        Of the lowest and the highest view of an object, degrees; by default those from which people look at it.
    """
    extent = extent or measure_extent(model)
    u = np.full((count, 4), 0.5) if jitter is None else np.asarray(jitter, dtype=np.float64)
    focal = width / (2.0 * np.tan(_CONFIG.field_of_view / 2.0))
    azimuth = GOLDEN_ANGLE * np.arange(count) + 2 * np.pi * (u[:, 0] - 0.5) / max(count, 1)
    cameras = []
    for k in range(count):
        shell = (k + u[k, 1]) / count  # stratified: the elevations of a rig cover their range
        if extent.is_room:
            elevation = np.radians(-20.0 + 40.0 * shell)
            toward = direction(azimuth[k], elevation)
            eye = extent.center - 0.25 * extent.radius * toward * (0.5 + u[k, 2])
            target = extent.center + extent.radius * toward
        else:
            low, high = (extent.lowest, _CONFIG.highest) if elevations is None else elevations
            elevation = np.radians(low + (high - low) * shell)
            fit = 1.06 * extent.radius / np.sin(_CONFIG.field_of_view / 2.0)
            eye = extent.center + direction(azimuth[k], elevation) * fit * (0.85 + 0.3 * u[k, 2])
            target = extent.center + 0.1 * extent.radius * (u[k, 3] - 0.5) * direction(azimuth[k] + 1.0, 0.0)
        cameras.append(look_at(eye, target, UP, focal, width, height))
    return cameras


def direction(azimuth: float, elevation: float) -> Float64:
    """Unit vector; positive elevations lie towards UP."""
    flat = np.array([np.cos(azimuth), 0.0, np.sin(azimuth)]) * np.cos(elevation)
    return np.asarray(flat + UP * np.sin(elevation))
