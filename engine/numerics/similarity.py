"""Similarity transforms of a Gaussian model: x_new = scale * R @ x + t."""

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float64, GaussianModel
from engine.numerics.spherical_harmonics import sh_rotation

MIRROR = np.array([-1.0, 1.0, 1.0], dtype=np.float32)
"""The mirror that `mirror_model` holds up: x is negated. Any other mirror is this one and a proper rotation."""
MIRROR_QUATS = np.array([1.0, 1.0, -1.0, -1.0], dtype=np.float32)
"""What it does to a quaternion w, x, y, z: the axis of a turn keeps x and loses its sense."""
ODD_IN_X = (3, 4, 7, 10, 13, 15)
"""Spherical harmonics, of the 16 up to degree 3, that change their sign with x."""


def quaternion_product(p: npt.ArrayLike, q: npt.ArrayLike) -> Float64:
    """Hamilton product p * q of quaternions (..., 4) in the order w, x, y, z; float64, broadcasting."""
    a, b = np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64)
    pw, px, py, pz = (a[..., i] for i in range(4))
    qw, qx, qy, qz = (b[..., i] for i in range(4))
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )


def rotation_to_quaternion(R: npt.ArrayLike) -> Float64:
    """Unit quaternions (..., 4), w, x, y, z with w >= 0, of proper rotation matrices (..., 3, 3)."""
    matrices = np.asarray(R, dtype=np.float64)
    xx, xy, xz, yx, yy, yz, zx, zy, zz = matrices.reshape(-1, 9).T
    # Four times the products of each component with all four: the row of the largest is the exact one (Shepperd 1978).
    rows = np.array(
        [
            [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, 1 + xx - yy - zz, yx + xy, xz + zx],
            [xz - zx, yx + xy, 1 - xx + yy - zz, zy + yz],
            [yx - xy, xz + zx, zy + yz, 1 - xx - yy + zz],
        ]
    )  # (4, 4, n)
    largest = np.einsum("iin->in", rows).argmax(axis=0)
    quats = rows[largest, :, np.arange(len(largest))]  # (n, 4)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    first = quats[np.arange(len(quats)), (quats != 0).argmax(axis=1)]  # w, or what comes first where that is zero
    return np.asarray((quats * np.sign(first)[:, None]).reshape(*matrices.shape[:-2], 4))


def quaternion_to_rotation(quats: npt.ArrayLike) -> Float64:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4), w, x, y, z."""
    q = np.asarray(quats, dtype=np.float64)
    w, x, y, z = (q[..., i] for i in range(4))
    R = np.empty((*q.shape[:-1], 3, 3))  # filled in place: to stack nine arrays takes longer than to compute them
    R[..., 0, 0] = 1 - 2 * (y * y + z * z)
    R[..., 0, 1] = 2 * (x * y - w * z)
    R[..., 0, 2] = 2 * (x * z + w * y)
    R[..., 1, 0] = 2 * (x * y + w * z)
    R[..., 1, 1] = 1 - 2 * (x * x + z * z)
    R[..., 1, 2] = 2 * (y * z - w * x)
    R[..., 2, 0] = 2 * (x * z - w * y)
    R[..., 2, 1] = 2 * (y * z + w * x)
    R[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return R


def transform_model(model: GaussianModel, scale: float, R: npt.ArrayLike, t: npt.ArrayLike) -> GaussianModel:
    """The model moved by a similarity: the same scene, seen from an equally moved camera. Opacities stay as they were.

    `scale` is positive, `R` (3, 3) a proper rotation, `t` (3,) a translation in units of the result; InputError if they
    are not.
    """
    rotation, shift = np.asarray(R, dtype=np.float64), np.asarray(t, dtype=np.float64)
    if not (np.isfinite(scale) and scale > 0):
        raise InputError(f"scale of a similarity must be positive, got {scale}")
    if shift.shape != (3,) or not np.isfinite(shift).all():
        raise InputError(f"translation must be three finite numbers, got {t!r}")
    if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-5):
        raise InputError("R is not a (3, 3) rotation matrix")
    if np.linalg.det(rotation) < 0:
        raise InputError("R mirrors the scene; a similarity of Gaussians needs a proper rotation")
    means = model.means.astype(np.float64) @ (scale * rotation).T + shift
    quats, sh = model.quats, model.sh
    if (rotation != np.eye(3)).any():
        quats = quaternion_product(rotation_to_quaternion(rotation), model.quats).astype(np.float32)
        if model.sh_degree > 0:
            sh = model.sh.copy()
            wigner = sh_rotation(rotation, model.sh_degree)[1:, 1:].astype(np.float32)
            sh[:, 1:] = np.matmul(wigner, model.sh[:, 1:])
    return model.with_(
        means=means.astype(np.float32), log_scales=model.log_scales + np.float32(np.log(scale)), quats=quats, sh=sh
    )


def mirror_model(model: GaussianModel) -> GaussianModel:
    """The model's image in the plane x = 0, its own inverse: the same scene, seen from a mirrored camera."""
    sh = model.sh.copy()
    for k in ODD_IN_X:
        if k < sh.shape[1]:
            sh[:, k] *= -1
    return model.with_(means=model.means * MIRROR, quats=model.quats * MIRROR_QUATS, sh=sh)
