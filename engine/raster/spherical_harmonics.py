"""Colours of Gaussians as a camera sees them."""

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.kernels.thread_crew import thread_count
from engine.model import Float32, Int32
from engine.numerics.spherical_harmonics import sh_basis
from engine.raster.lane_memory import aligned
from engine.raster.sh_kernels import SH_SCRATCH, evaluate_sh

__all__ = ["check_harmonics", "sh_basis", "sh_colors"]

_ALL = np.zeros(0, dtype=np.int32)


def check_harmonics(sh: Float32, means: Float32, camera_position: npt.ArrayLike) -> tuple[Float32, Float32, Float32]:
    """Coefficients, centres and a point as kernels take them; InputError if a shape is wrong."""
    sh, means = np.ascontiguousarray(sh, np.float32), np.ascontiguousarray(means, np.float32)
    position = np.asarray(camera_position, dtype=np.float32)
    if sh.ndim != 3 or sh.shape[1] not in (1, 4, 9, 16) or sh.shape[2] != 3:
        raise InputError(f"sh has shape {sh.shape}, expected (N, K, 3) with K = 1, 4, 9 or 16")
    if means.shape != (len(sh), 3) or position.shape != (3,):
        raise InputError(
            f"means has shape {means.shape} and the camera position {position.shape}, expected {(len(sh), 3)} and (3,)"
        )
    return sh, means, position


def sh_colors(sh: Float32, means: Float32, camera_position: npt.ArrayLike) -> Float32:
    """Colours (N, 3) of Gaussians seen from a point: ``max(0, 0.5 + sum_k Y_k(d) sh[k])``, d from camera to Gaussian;
    not clipped at 1.

    `sh` (N, K, 3) has K = 1, 4, 9 or 16. InputError if a shape is wrong.
    """
    sh, means, position = check_harmonics(sh, means, camera_position)
    colors = np.empty((len(sh), 3), dtype=np.float32)
    evaluate(sh, means, position, _ALL, colors)
    return colors


def evaluate(sh: Float32, means: Float32, position: Float32, wanted: Int32, colors: Float32) -> None:
    """`sh_colors` into an array of the caller's, shapes unchecked; where `wanted` (N,) is 0 a Gaussian's colour
    is undefined."""
    scratch, rows = aligned((thread_count(), SH_SCRATCH)), np.empty((thread_count(), 16), dtype=np.int64)
    evaluate_sh(sh.ravel(), sh.shape[1], means.ravel(), position, wanted, scratch, rows, colors.reshape(-1))
