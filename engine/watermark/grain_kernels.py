"""Kernels of the grain: every Gaussian in its own axes, one at a time."""

# mypy: allow-untyped-defs

import math

import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of

__all__ = ["axes_of", "displace", "middle_of", "pull_along"]


@inlined
def axes_of(q):
    """The three axes that a unit quaternion turns those of space into."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


@inlined
def middle_of(s):
    """The second of three."""
    return max(min(s[0], s[1]), min(max(s[0], s[1]), s[2]))


@inlined
def _turned_axes(quats, i):
    q = (np.float64(quats[i, 0]), np.float64(quats[i, 1]), np.float64(quats[i, 2]), np.float64(quats[i, 3]))
    return axes_of(q)


@inlined
def _sizes(log_scales, i):
    """Scales, and the second of them."""
    s = (
        math.exp(np.float64(log_scales[i, 0])),
        math.exp(np.float64(log_scales[i, 1])),
        math.exp(np.float64(log_scales[i, 2])),
    )
    return s, middle_of(s)


@parallel_kernel
def displace(means, log_scales, quats, signs, steps, limits, out_means, out_log_scales, call):
    """Moves centres and log scales by `steps` (2,), in `grain.units` along the own axes, where signs (N, 6) say to;
    `limits` (2,) are what a thin axis counts for and below which it has no size to move, of the middle scale."""
    for i in share_of(len(means), call):
        axes = _turned_axes(quats, i)
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
def pull_along(log_scales, quats, by_means, by_log_scales, limits, out, call):
    """Gradients by the grain's own coordinates, to out (N, 6), from those by centres and log scales (N, 3)."""
    for i in share_of(len(out), call):
        axes = _turned_axes(quats, i)
        sizes, middle = _sizes(log_scales, i)
        for a in range(3):
            along = axes[a][0] * by_means[i, 0] + axes[a][1] * by_means[i, 1] + axes[a][2] * by_means[i, 2]
            out[i, a] = along * max(sizes[a], limits[0] * middle)
            out[i, 3 + a] = by_log_scales[i, a]
