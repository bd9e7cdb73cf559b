"""A model after its matter has moved: means, covariances and colours follow (Eq 12)."""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float32, Float64, GaussianModel, Int32
from engine.numerics.jit import parallel_section
from engine.numerics.spherical_harmonics import sh_rotation
from engine.sim.physics.deforming_kernels import deform_covariances, rotation_parts, turn_sh

__all__ = ["deform_model", "polar_rotations"]

BATCH = 16_384
"""Rotations turned into Wigner matrices at a time: 16 MB in float32."""


def deform_model(
    model: GaussianModel, means: npt.NDArray[Any], gradients: npt.NDArray[Any], element: npt.NDArray[Any] | None = None
) -> GaussianModel:
    """The model with its Gaussians moved, strained and turned.

    Parameters
    ----------
    model : GaussianModel
        N Gaussians at rest.
    means : (N, 3)
        Their new centres, scene units.
    gradients : (T, 3, 3)
        Deformation gradients F, x_new = F x_old near by. Mirroring and singular ones are allowed.
    element : (N,) integer, optional
        Gradient of each Gaussian; Gaussian n has gradient n where not given.

    Returns
    -------
    GaussianModel
        Covariances F Sigma F^T; SH turned by the rotation part of F (the nearest proper rotation); opacities as
        they were. An axis that F flattens keeps 1e-10 of the Gaussian's largest standard deviation.

    Raises
    ------
    InputError
        If a shape is wrong, an index is out of range, or a number is not finite.

    Notes
    -----
    Eq 12 of the paper; Xie et al., "PhysGaussian", CVPR 2024, for turning the harmonics by polar
    decomposition.
    """
    count = len(model)
    matrices = np.ascontiguousarray(gradients, dtype=np.float64)
    if matrices.ndim != 3 or matrices.shape[1:] != (3, 3):
        raise InputError(f"deformation gradients have shape {matrices.shape}, expected (T, 3, 3)")
    if np.shape(means) != (count, 3):
        raise InputError(f"deformed means have shape {np.shape(means)}, expected ({count}, 3)")
    index: Int32 = np.ascontiguousarray(np.arange(count) if element is None else element, dtype=np.int32)
    if index.shape != (count,):
        raise InputError(f"{index.shape} elements for {count} Gaussians")
    if count and (index.min() < 0 or index.max() >= len(matrices)):
        raise InputError(f"elements {index.min()} to {index.max()} of {len(matrices)} gradients")
    if not (np.isfinite(matrices).all() and np.isfinite(means).all()):
        raise InputError("deformed centres and gradients must be finite")
    log_scales, quats = np.empty_like(model.log_scales), np.empty_like(model.quats)
    with parallel_section():
        deform_covariances(model.log_scales, model.quats, matrices, index, log_scales, quats)
    return model.with_(means=means, log_scales=log_scales, quats=quats, sh=_turned(model, matrices, index))


def polar_rotations(gradients: npt.NDArray[Any]) -> Float64:
    """Proper rotations nearest to the gradients, (T, 3, 3) to (T, 3, 3); defined for every finite matrix."""
    matrices = np.ascontiguousarray(gradients, dtype=np.float64)
    rotations = np.empty_like(matrices)
    with parallel_section():
        rotation_parts(matrices, rotations)
    return rotations


def _turned(model: GaussianModel, gradients: Float64, index: Int32) -> Float32:
    """SH of all Gaussians, each turned by the rotation part of its gradient."""
    if model.sh_degree == 0 or len(model) == 0:
        return model.sh
    order = np.argsort(index, kind="stable")
    turned = np.empty_like(model.sh)
    rotations = polar_rotations(gradients)
    for first in range(0, len(gradients), BATCH):
        low, high = np.searchsorted(index[order], [first, first + BATCH])
        if low == high:
            continue
        own = order[low:high]
        wigner = sh_rotation(rotations[first : first + BATCH], model.sh_degree).astype(np.float32)
        part = np.empty((len(own), *model.sh.shape[1:]), dtype=np.float32)
        with parallel_section():
            turn_sh(model.sh[own], wigner, index[own] - np.int32(first), part)
        turned[own] = part
    return turned
