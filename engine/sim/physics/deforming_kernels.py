"""Kernels that carry Gaussians along with the matter around them."""

# mypy: allow-untyped-defs, allow-untyped-calls
import math

import numba
import numpy as np

from engine.numerics.jit import parallel_kernel
from engine.sim.physics.decompositions import orthogonalize, rotation_columns, rotation_part, to_quaternion

_KERNEL_VERSION = 2

THINNEST = 1e-10
"""Smallest standard deviation kept, as a share of the Gaussian's largest: log scales stay finite."""
TINIEST = 1e-30
"""Smallest standard deviation at all, scene units."""


@parallel_kernel
def deform_covariances(log_scales, quats, gradients, element, new_log_scales, new_quats):
    """F Sigma F^T (Eq 12) of every Gaussian, as scales and rotation; gradients (T, 3, 3) float64.

    With Sigma = (R S)(R S)^T the new covariance is A A^T for A = F R S; orthogonal columns of A V are its
    axes. Nothing is squared, so the result is symmetric and positive by construction.
    """
    for n in numba.prange(len(quats)):
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


@parallel_kernel
def rotation_parts(gradients, rotations):
    """Rotation of the polar decomposition of each gradient (T, 3, 3)."""
    for t in numba.prange(len(gradients)):
        rotation_part(gradients[t], rotations[t])


@parallel_kernel
def turn_sh(sh, wigner, element, turned):
    """turned[n] = wigner[element[n]] @ sh[n], block by block; wigner (T, K, K), sh (N, K, 3) float32."""
    count = sh.shape[1]
    for n in numba.prange(len(sh)):
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
def interpolate(values, tets, tet, weights, out):
    """out[n] = sum of weights[n, k] * values[tets[tet[n], k]]; values (P, 3), out (N, 3) float64."""
    for n in numba.prange(len(tet)):
        corner = tets[tet[n]]
        for axis in range(3):
            total = 0.0
            for k in range(4):
                total += weights[n, k] * values[corner[k], axis]
            out[n, axis] = total
