"""Real spherical harmonics in INRIA's signs, and how their coefficients turn with the scene."""

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import SH_C0, Float64

SH_C1 = 0.4886025119029199
SH_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
SH_C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)


def sh_basis(directions: npt.NDArray[Any], degree: int) -> npt.NDArray[Any]:
    """Spherical-harmonic basis functions Y_k at unit directions (..., 3), which are not normalised here.

    Returns (..., K) of the directions' dtype, K = (degree + 1)^2: ``0.5 + sh_basis(d, degree) @ sh`` is the colour seen
    from camera to Gaussian. InputError if the degree is not 0 to 3.

    Sloan, "Efficient Spherical Harmonic Evaluation", JCGT 2013, with the Condon-Shortley signs of INRIA's reference
    implementation of 3D Gaussian Splatting.
    """
    if not 0 <= degree <= 3:
        raise InputError(f"spherical-harmonic degree is {degree}, expected 0 to 3")
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    bands = [np.full_like(x, SH_C0)]
    if degree > 0:
        bands += [-SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    if degree > 1:
        xx, yy, zz = x * x, y * y, z * z
        a, b, c = SH_C2
        bands += [a * x * y, -a * y * z, b * (2 * zz - xx - yy), -a * x * z, c * (xx - yy)]
    if degree > 2:
        d, e, f, g, h = SH_C3
        bands += [
            -d * y * (3 * xx - yy),
            e * x * y * z,
            -f * y * (4 * zz - xx - yy),
            g * z * (2 * zz - 3 * xx - 3 * yy),
            -f * x * (4 * zz - xx - yy),
            h * z * (xx - yy),
            -d * x * (xx - 3 * yy),
        ]
    return np.stack(bands, axis=-1)  # (..., K)


@lru_cache(maxsize=1)
def _probe() -> tuple[Float64, tuple[Float64, ...]]:
    """32 well-spread directions and, per degree, the pseudo-inverse of the basis on them."""
    i = np.arange(32) + 0.5
    z = 1.0 - 2.0 * i / 32
    phi = i * np.pi * (3.0 - np.sqrt(5.0))  # golden-angle spiral
    r = np.sqrt(1.0 - z * z)
    directions = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)  # (32, 3)
    basis = sh_basis(directions, 3)
    return directions, tuple(np.linalg.pinv(basis[:, l * l : (l + 1) ** 2]) for l in range(4))


def sh_rotation(R: npt.ArrayLike, degree: int) -> Float64:
    """(..., K, K) float64 that turn SH coefficients with the scene (real Wigner D-matrices, one block per degree).

    For proper rotations (..., 3, 3), x_new = R @ x: ``sh_new = sh_rotation(R, degree) @ sh``, so that the new colour
    from direction R @ d is the old colour from direction d. InputError if the degree is not 0 to 3.
    """
    rotation = np.asarray(R, dtype=np.float64)
    directions, inverses = _probe()
    # Y(d) D = Y(R^T d) on the fixed directions; each degree is closed under rotation, so the least-squares
    # solution is exact.
    turned = sh_basis(directions @ rotation, degree)
    out = np.zeros((*rotation.shape[:-2], turned.shape[-1], turned.shape[-1]))
    for l in range(degree + 1):
        block = slice(l * l, (l + 1) ** 2)
        out[..., block, block] = inverses[l] @ turned[..., block]
    return out
