"""The grain: a second layer of chips, on every Gaussian's centre and size (DESIGN 4.5).

Each centre moves by a small part of the Gaussian's own size along each of its three axes, each log scale by a small
step; the signs follow from the owner's key. Nothing predicts where a Gaussian's centre lies to a twentieth of its size,
neither its neighbors nor its color, so this layer cannot be averaged away: it goes only with the geometry.
Opacities stay: their chips would be a seventh of all, and the first to go in merging, pruning and re-training.

Flat order of the chips: Gaussian, then its attributes (centre along axes 0 to 2, log scale of axes 0 to 2).
"""

from dataclasses import dataclass

import numpy as np

from engine.model import Bool, Float32, Float64, GaussianModel
from engine.watermark.config import CONFIG
from engine.watermark.grain_kernels import displace

_CONFIG = CONFIG.grain


ATTRIBUTES = 6
"""Chips of one Gaussian."""


@dataclass(frozen=True)
class Grain:
    """How far the chips of the second layer displace; zeros stand for no grain (a record of the first version)."""

    center: float = 0.0  # of the size along the axis, see `units`; 0 to 1
    scale: float = 0.0  # of a log scale; 0 to 1

    @property
    def there(self) -> bool:
        """Whether there is a second layer."""
        return self.center > 0.0 or self.scale > 0.0

    def chips(self, gaussians: int) -> int:
        """Number of its chips on a model of so many Gaussians."""
        return ATTRIBUTES * gaussians if self.there else 0

    def displacements(self, values: Float64) -> Float64:
        """(6 N,) displacements, in `units` and log scales, of chips with these values (6 N,)."""
        each = values.reshape(-1, 2, ATTRIBUTES // 2) * np.array([self.center, self.scale])[:, None]
        return np.asarray(each.reshape(-1))

    def times(self, factor: float) -> "Grain":
        """The grain made finer or coarser."""
        return Grain(float(np.float32(self.center * factor)), float(np.float32(self.scale * factor)))


def units(log_scales: Float32) -> Float64:
    """(N, 3) length along each own axis, scene units, of which a centre moves a fixed part."""
    scales = np.exp(log_scales.astype(np.float64))  # (N, 3)
    return np.maximum(scales, _CONFIG.flat * _middle(scales)[:, None])


def thin(log_scales: Float32) -> Bool:
    """(N, 3) axes whose scale is no more than the thickness of a disc."""
    scales = np.exp(log_scales.astype(np.float64))
    return np.asarray(scales < _CONFIG.thinnest * _middle(scales)[:, None])


def _middle(scales: Float64) -> Float64:
    """(N,) the second of three."""
    return np.maximum(
        np.minimum(scales[:, 0], scales[:, 1]), np.minimum(np.maximum(scales[:, 0], scales[:, 1]), scales[:, 2])
    )


def roughen(model: GaussianModel, grain: Grain, signs: Float32) -> GaussianModel:
    """The model with every centre and log scale displaced.

    Parameters
    ----------
    signs : (N, 6)
        Of each chip: chip times bit, times its size where chips have sizes.
    """
    means, log_scales = np.empty_like(model.means), np.empty_like(model.log_scales)
    steps, limits = np.array([grain.center, grain.scale]), np.array([_CONFIG.flat, _CONFIG.thinnest])
    displace(model.means, model.log_scales, model.quats, signs, steps, limits, means, log_scales)
    return model.with_(means=means, log_scales=log_scales)
