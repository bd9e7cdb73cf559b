"""Kernels between lattice points and the Gaussians bound to them."""

import numba

from engine.numerics.jit import parallel_kernel

_KERNEL_VERSION = 1


@parallel_kernel
def interpolate(values, tets, tet, weights, out):  # type: ignore[no-untyped-def]
    """out[n] = sum of weights[n, k] * values[tets[tet[n], k]]; values (P, 3), out (N, 3) float64."""
    for n in numba.prange(len(tet)):
        corner = tets[tet[n]]
        for axis in range(3):
            total = 0.0
            for k in range(4):
                total += weights[n, k] * values[corner[k], axis]
            out[n, axis] = total
