"""A model after its matter has moved: means, covariances and colors follow (Eq 12)."""

# mypy: allow-untyped-defs, allow-untyped-calls
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.kernels.jit import parallel_kernel, share_of
from engine.lab.sim.physics.decompositions import orthogonalize, rotation_columns, rotation_part, to_quaternion
from engine.model import Float32, Float64, GaussianModel, Int32
from engine.numerics.spherical_harmonics import sh_rotation

THINNEST = 1e-10  # smallest standard deviation kept, as a share of the Gaussian's largest: log scales stay finite
TINIEST = 1e-30  # smallest standard deviation at all, scene units
BATCH = 16_384  # rotations turned into Wigner matrices at a time: 16 MB in float32


def deform_model(
    model: GaussianModel, means: npt.NDArray[Any], gradients: npt.NDArray[Any], element: npt.NDArray[Any] | None = None
) -> GaussianModel:
    """The model with its Gaussians moved to `means` (N, 3), strained and turned: covariances F Sigma F^T (Eq 12).

    `gradients` (T, 3, 3) are deformation gradients F, x_new = F x_old near by, mirroring and singular ones allowed;
    `element` (N,) is the gradient of each Gaussian, n for Gaussian n where not given. SH are turned by the rotation
    part of F, the nearest proper rotation (Xie et al., "PhysGaussian", CVPR 2024); opacities stay. An axis that F
    flattens keeps 1e-10 of the Gaussian's largest standard deviation.
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
        raise InputError("deformed centers and gradients must be finite")
    log_scales, quats = np.empty_like(model.log_scales), np.empty_like(model.quats)
    deform_covariances(model.log_scales, model.quats, matrices, index, log_scales, quats)
    return model.with_(means=means, log_scales=log_scales, quats=quats, sh=_turned(model, matrices, index))


def polar_rotations(gradients: npt.NDArray[Any]) -> Float64:
    """Proper rotations nearest to the gradients, (T, 3, 3) to (T, 3, 3); defined for every finite matrix."""
    matrices = np.ascontiguousarray(gradients, dtype=np.float64)
    rotations = np.empty_like(matrices)
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
        turn_sh(model.sh[own], wigner, index[own] - np.int32(first), part)
        turned[own] = part
    return turned


@parallel_kernel(allocates=True)
def deform_covariances(log_scales, quats, gradients, element, new_log_scales, new_quats, call):
    """F Sigma F^T (Eq 12) of every Gaussian, as scales and rotation; gradients (T, 3, 3) float64.

    With Sigma = (R S)(R S)^T the new covariance is A A^T for A = F R S; orthogonal columns of A V are its
    axes. Nothing is squared, so the result is symmetric and positive by construction.
    """
    for n in share_of(len(quats), call):
        f = gradients[element[n]]
        w, x = np.float64(quats[n, 0]), np.float64(quats[n, 1])
        y, z = np.float64(quats[n, 2]), np.float64(quats[n, 3])
        # Of unit length in float64, or the columns below would start a little off the perpendicular, and
        # axes of nearly the same length would turn a lot to make up for it.
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w / norm, x / norm, y / norm, z / norm
        turn = np.empty((3, 3))
        turn[0, 0], turn[0, 1], turn[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        turn[1, 0], turn[1, 1], turn[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        turn[2, 0], turn[2, 1], turn[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        a, v, r, q = np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3)), np.empty(4)
        for l in range(3):
            scale = math.exp(np.float64(log_scales[n, l]))
            v[l, l] = 1.0
            for k in range(3):
                a[k, l] = scale * (f[k, 0] * turn[0, l] + f[k, 1] * turn[1, l] + f[k, 2] * turn[2, l])
        orthogonalize(a, v)
        rotation_columns(a, r)
        to_quaternion(r, q)
        sign = 1.0 if q[0] * w + q[1] * x + q[2] * y + q[3] * z >= 0.0 else -1.0
        for k in range(4):
            new_quats[n, k] = sign * q[k]
        largest = 0.0
        for l in range(3):
            v[0, l] = math.sqrt(a[0, l] ** 2 + a[1, l] ** 2 + a[2, l] ** 2)
            largest = max(largest, v[0, l])
        for l in range(3):
            new_log_scales[n, l] = math.log(max(v[0, l], THINNEST * largest, TINIEST))


@parallel_kernel(allocates=True)
def rotation_parts(gradients, rotations, call):
    """Rotation of the polar decomposition of each gradient (T, 3, 3)."""
    for t in share_of(len(gradients), call):
        rotation_part(gradients[t], rotations[t])


@parallel_kernel(allocates=True)
def turn_sh(sh, wigner, element, turned, call):
    """turned[n] = wigner[element[n]] @ sh[n], block by block; wigner (T, K, K), sh (N, K, 3) float32."""
    count = sh.shape[1]
    for n in share_of(len(sh), call):
        d = wigner[element[n]]
        for k in range(count):
            degree = 0 if k < 1 else (1 if k < 4 else (2 if k < 9 else 3))
            red, green, blue = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for l in range(degree * degree, (degree + 1) * (degree + 1)):
                red += d[k, l] * sh[n, l, 0]
                green += d[k, l] * sh[n, l, 1]
                blue += d[k, l] * sh[n, l, 2]
            turned[n, k, 0], turned[n, k, 1], turned[n, k, 2] = red, green, blue


@parallel_kernel
def interpolate(values, tets, tet, weights, out, call):
    """out[n] = sum of weights[n, k] * values[tets[tet[n], k]]; values (P, 3), out (N, 3) float64."""
    for n in share_of(len(tet), call):
        corner = tets[tet[n]]
        for axis in range(3):
            total = 0.0
            for k in range(4):
                total += weights[n, k] * values[corner[k], axis]
            out[n, axis] = total
