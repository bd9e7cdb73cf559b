"""The grain: a second layer of chips, on every Gaussian's centre and size (DESIGN 4.5).

Each centre moves by a small part of the Gaussian's own size along each of its three axes, each log scale by a small
step; the signs follow from the owner's key. Nothing predicts where a Gaussian's centre lies to a twentieth of its size,
neither its neighbors nor its color, so this layer cannot be averaged away: it goes only with the geometry.
Opacities stay: their chips would be a seventh of all, and the first to go in merging, pruning and re-training.

Flat order of the chips: Gaussian, then its attributes (centre along axes 0 to 2, log scale of axes 0 to 2).
"""

import math
from dataclasses import dataclass

import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.model import Bool, Float32, Float64, GaussianModel
from engine.watermark.config import CONFIG

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


@inlined
def axes_of(q):  # type: ignore[no-untyped-def]
    """The three axes that a unit quaternion turns those of space into."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


@inlined
def middle_of(s):  # type: ignore[no-untyped-def]
    """The second of three."""
    return max(min(s[0], s[1]), min(max(s[0], s[1]), s[2]))


@inlined
def turned_axes(quats, i):  # type: ignore[no-untyped-def]
    """`axes_of` a row."""
    q = (np.float64(quats[i, 0]), np.float64(quats[i, 1]), np.float64(quats[i, 2]), np.float64(quats[i, 3]))
    return axes_of(q)


@inlined
def _sizes(log_scales, i):  # type: ignore[no-untyped-def]
    """Scales, and the second of them."""
    s = (
        math.exp(np.float64(log_scales[i, 0])),
        math.exp(np.float64(log_scales[i, 1])),
        math.exp(np.float64(log_scales[i, 2])),
    )
    return s, middle_of(s)


@parallel_kernel
def displace(means, log_scales, quats, signs, steps, limits, out_means, out_log_scales, call):  # type: ignore[no-untyped-def]
    """Moves centres and log scales by `steps` (2,), in `grain.units` along the own axes, where signs (N, 6) say to;
    `limits` (2,) are what a thin axis counts for and below which it has no size to move, of the middle scale."""
    for i in share_of(len(means), call):
        axes = turned_axes(quats, i)
        sizes, middle = _sizes(log_scales, i)
        x, y, z = 0.0, 0.0, 0.0
        for a in range(3):
            far = steps[0] * signs[i, a] * max(sizes[a], limits[0] * middle)
            x += axes[a][0] * far
            y += axes[a][1] * far
            z += axes[a][2] * far
            thin = sizes[a] < limits[1] * middle
            out_log_scales[i, a] = log_scales[i, a] + (0.0 if thin else steps[1] * signs[i, 3 + a])
        out_means[i, 0], out_means[i, 1], out_means[i, 2] = means[i, 0] + x, means[i, 1] + y, means[i, 2] + z


@parallel_kernel
def pull_along(log_scales, quats, by_means, by_log_scales, limits, out, call):  # type: ignore[no-untyped-def]
    """Gradients by the grain's own coordinates, to out (N, 6), from those by centres and log scales (N, 3)."""
    for i in share_of(len(out), call):
        axes = turned_axes(quats, i)
        sizes, middle = _sizes(log_scales, i)
        for a in range(3):
            along = axes[a][0] * by_means[i, 0] + axes[a][1] * by_means[i, 1] + axes[a][2] * by_means[i, 2]
            out[i, a] = along * max(sizes[a], limits[0] * middle)
            out[i, 3 + a] = by_log_scales[i, a]
