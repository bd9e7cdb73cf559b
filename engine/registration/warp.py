"""Smooth fields of affine maps: fitted to pairs, blended, and applied to Gaussians."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import scipy

from engine.model import Float64, GaussianModel
from engine.numerics.similarity import quaternion_to_rotation
from engine.registration.config import CONFIG
from engine.registration.matching import Deviations

Affine = npt.NDArray[np.float64]
"""(..., 3, 4): x_target = map[..., :3] @ x_source + map[..., 3]."""


def fit_affine(source: Float64, target: Float64, prior: Affine) -> Affine:
    """Robust affine maps (B, 3, 4) of batches of paired points (B, n, 3) (Geman-McClure), held to a prior where the
    pairs tell nothing.

    `prior` (B, 3, 4) are roughly right maps; their linear part, turned as the pairs say, fills in what a flat piece
    leaves open.
    """
    w, current = np.ones(source.shape[:2]), prior
    for turn in range(CONFIG.deformation.reweightings):
        total = np.maximum(w.sum(axis=1), 1e-12)[:, None]
        a = np.einsum("bn,bni->bi", w, source) / total  # (B, 3)
        b = np.einsum("bn,bni->bi", w, target) / total  # (B, 3)
        da, db = source - a[:, None], target - b[:, None]
        spread = np.einsum("bn,bni,bnj->bij", w, da, da) / total[..., None]  # (B, 3, 3)
        cross = np.einsum("bn,bni,bnj->bij", w, db, da) / total[..., None]  # (B, 3, 3)
        linear = _turned(prior[:, :, :3], cross, spread)
        hold = CONFIG.deformation.ridge * np.trace(spread, axis1=1, axis2=2)[:, None, None] / 3.0 + 1e-30
        solved = np.linalg.solve(
            spread + hold * np.eye(3), np.swapaxes(cross + hold * linear, 1, 2)
        )  # symmetric: the transposed equation
        A = np.swapaxes(solved, 1, 2)
        current = np.concatenate([A, (b - np.einsum("bij,bj->bi", A, a))[..., None]], axis=2)  # (B, 3, 4)
        if turn == CONFIG.deformation.reweightings - 1:
            break
        error = np.linalg.norm(apply(current[:, None], source) - target, axis=2)
        median = np.sort(error, axis=1)[:, [(error.shape[1] - 1) // 2]]  # (B, 1)
        scale = np.maximum(2.0 * median, 1e-9 * np.sqrt(hold[..., 0]))
        w = 1.0 / np.square(1.0 + np.square(error / scale))
    return current


def _turned(linear: Float64, cross: Float64, spread: Float64) -> Float64:
    """The prior's linear parts (B, 3, 3), turned by the rotation that fits them best to the pairs."""
    u, _, vt = np.linalg.svd(cross @ np.swapaxes(linear, 1, 2))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return np.asarray(u @ vt @ linear)


def apply(maps: Affine, points: npt.NDArray[np.floating]) -> Float64:
    """Points (..., 3) under maps (..., 3, 4)."""
    return (maps[..., :3] @ points.astype(np.float64)[..., None])[..., 0] + maps[..., 3]


def warped(model: GaussianModel, maps: Affine) -> GaussianModel:
    """Gaussians moved by an affine map each (N, 3, 4): centres, and covariances as A Sigma A^T.

    Log scales come in descending order; quaternions and colours stay as they were, so it is no use for rendering.
    """
    axes = (maps[:, :, :3] @ quaternion_to_rotation(model.quats)) * np.exp(model.log_scales.astype(np.float64))[:, None]
    squares = np.linalg.eigvalsh(axes @ np.swapaxes(axes, 1, 2))
    return model.with_(means=apply(maps, model.means), log_scales=0.5 * np.log(np.maximum(squares[:, ::-1], 1e-30)))


def blend(nodes: npt.NDArray[np.floating], maps: Affine, points: npt.NDArray[np.floating], near: int = 4) -> Affine:
    """Maps (N, 3, 4) at points (N, 3), from those (A, 3, 4) at the `near` nearest of the nodes (A, 3)."""
    near = min(near, len(nodes))
    distance, index = scipy.spatial.cKDTree(nodes).query(points, k=near, workers=2)
    distance, index = distance.reshape(-1, near), index.reshape(-1, near)  # (N, near)
    reach = np.maximum(distance[:, -1:], 1e-30)
    weights = np.square(1.0 - np.square(0.999 * distance / reach))
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("nk,nkij->nij", weights, maps[index]))  # (N, 3, 4)


def unturned(deviations: Deviations) -> Deviations:
    """The warped model without rotations: the axes of a deformed ellipsoid cannot be matched."""
    return replace(deviations, rotation=np.inf)
