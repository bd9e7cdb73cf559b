"""Colours of Gaussians as a camera sees them, and the gradient back to the coefficients."""

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.kernels.thread_crew import thread_count
from engine.model import Float32, Int32
from engine.numerics.spherical_harmonics import sh_basis
from engine.raster.lane_memory import aligned
from engine.raster.sh_kernels import SH_SCRATCH, evaluate_sh, spread_sh

__all__ = ["sh_basis", "sh_colors", "sh_colors_backward"]

_ALL = np.zeros(0, dtype=np.int32)


def _checked(sh: Float32, means: Float32, camera_position: npt.ArrayLike) -> tuple[Float32, Float32, Float32]:
    sh, means = np.ascontiguousarray(sh, np.float32), np.ascontiguousarray(means, np.float32)
    position = np.asarray(camera_position, dtype=np.float32)
    if sh.ndim != 3 or sh.shape[1] not in (1, 4, 9, 16) or sh.shape[2] != 3:
        raise InputError(f"sh has shape {sh.shape}, expected (N, K, 3) with K = 1, 4, 9 or 16")
    if means.shape != (len(sh), 3) or position.shape != (3,):
        raise InputError(
            f"means has shape {means.shape} and the camera position {position.shape}, expected {(len(sh), 3)} and (3,)"
        )
    return sh, means, position


def sh_colors(sh: Float32, means: Float32, camera_position: npt.ArrayLike, wanted: Int32 = _ALL) -> Float32:
    """Colours (N, 3) of Gaussians seen from a point: ``max(0, 0.5 + sum_k Y_k(d) sh[k])``, d from camera to Gaussian;
    not clipped at 1.

    `sh` (N, K, 3) has K = 1, 4, 9 or 16; Gaussians where `wanted` (N,) is 0 are left out (their colours are undefined).
    InputError if a shape is wrong.
    """
    sh, means, position = _checked(sh, means, camera_position)
    colors = np.empty((len(sh), 3), dtype=np.float32)
    evaluate(sh, means, position, wanted, colors)
    return colors


def evaluate(sh: Float32, means: Float32, position: Float32, wanted: Int32, colors: Float32) -> None:
    """`sh_colors` into an array of the caller's, shapes unchecked."""
    scratch, rows = aligned((thread_count(), SH_SCRATCH)), np.empty((thread_count(), 16), dtype=np.int64)
    evaluate_sh(sh.ravel(), sh.shape[1], means.ravel(), position, wanted, scratch, rows, colors.reshape(-1))


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
    sh, means, position = _checked(sh, means, camera_position)
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
