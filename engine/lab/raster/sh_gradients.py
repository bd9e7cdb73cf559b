"""The gradient of colours as a camera sees them, back to the coefficients."""

# mypy: allow-untyped-defs, allow-untyped-calls

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.kernels.jit import parallel_kernel, share_of
from engine.kernels.thread_crew import thread_count
from engine.model import Float32
from engine.raster.lane_memory import aligned, load, store
from engine.raster.sh_kernels import SH_SCRATCH, TURNED, set_direction, sh_lanes, store_colors
from engine.raster.spherical_harmonics import check_harmonics, sh_colors

__all__ = ["sh_colors_backward"]

_f = np.float32


def sh_colors_backward(
    cotangent: Float32,
    sh: Float32,
    means: Float32,
    camera_position: npt.ArrayLike,
    *,
    colors: Float32 | None = None,
    out: Float32 | None = None,
) -> Float32:
    """Gradient (N, K, 3) of `sh_colors` with respect to the coefficients, for (N, 3) dL/dcolors; 0 for a channel
    clamped at 0.

    `colors` (N, 3) are what `sh_colors` returned, to spare its evaluation (they say where the clamp at 0 holds); `out`
    (N, K, 3) is a C-contiguous array for the result: fresh memory costs more than the computation. InputError if a
    shape is wrong.
    """
    sh, means, position = check_harmonics(sh, means, camera_position)
    cotangent = np.ascontiguousarray(cotangent, np.float32)
    if cotangent.shape != (len(sh), 3):
        raise InputError(f"cotangent has shape {cotangent.shape}, expected {(len(sh), 3)}")
    seen = sh_colors(sh, means, position) if colors is None else np.ascontiguousarray(colors, np.float32)
    result = np.empty_like(sh) if out is None else out
    if seen.shape != cotangent.shape or result.shape != sh.shape:
        raise InputError(f"colors has shape {seen.shape} and out {result.shape}, expected (N, 3) and {sh.shape}")
    if result.dtype != np.float32 or not result.flags.c_contiguous:
        raise InputError("out must be a C-contiguous float32 array")
    scratch, out = aligned((thread_count(), SH_SCRATCH)), result.reshape(-1)
    spread_sh(cotangent.ravel(), seen.ravel(), sh.shape[1], means.ravel(), position, scratch, out)
    return result


@parallel_kernel
def spread_sh(cotangent, colors, coefficients, means, position, scratch, out, call):
    """out[i, k] = Y_k cotangent[i] where the colour was not clamped to 0, else 0. All arrays flat."""
    n = means.shape[0] // 3
    shares = scratch.shape[0]
    share = (n + shares - 1) // shares
    row = 3 * coefficients
    for part in share_of(shares, call):
        own = scratch[part]
        end = min(n, (part + 1) * share)
        for first in range(part * share, end, 16):
            size = min(16, end - first)
            for g in range(size):
                set_direction(own, g, means, first + g, position)
            sh_lanes(own, coefficients)
            for g in range(size):
                i = first + g
                y = load(own, TURNED + g * 16)
                for channel in range(3):
                    value = cotangent[3 * i + channel] if colors[3 * i + channel] > _f(0.0) else _f(0.0)
                    store(own, channel * 16, y * value)
                store_colors(out, i * row, row, end * row, load(own, 0), load(own, 16), load(own, 32))
