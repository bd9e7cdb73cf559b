"""Smooth fields of affine maps: fitted to pairs, blended, and applied to Gaussians."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from engine.model import Float64, GaussianModel
from engine.numerics.similarity import quaternion_to_rotation
from engine.registration.matching import Deviations

Affine = npt.NDArray[np.float64]
"""(..., 3, 4): x_target = map[..., :3] @ x_source + map[..., 3]."""

RIDGE = 0.02
"""Weight of the prior, in mean squares of the source: it decides only across flat pieces, which tell nothing there."""
ROUNDS = 4
"""Reweightings of the robust fit."""


def fit_affine(source: Float64, target: Float64, prior: Affine, weights: Float64 | None = None) -> Affine:
    """Robust affine maps of batches of pairs (Geman-McClure), held to a prior where the pairs tell nothing.

    Parameters
    ----------
    source, target : (B, n, 3) float64
        Paired points.
    prior : (B, 3, 4) float64
        Roughly right maps; their linear part, turned as the pairs say, fills in what a flat piece leaves open.
    weights : (B, n) float64, optional
        Not negative; all 1 by default. A batch without weight keeps its prior.

    Returns
    -------
    (B, 3, 4) float64
    """
    base = np.ones(source.shape[:2]) if weights is None else weights
    w, current = base, prior
    for turn in range(ROUNDS):
        total = np.maximum(w.sum(axis=1), 1e-12)[:, None]
        a = np.einsum("bn,bni->bi", w, source) / total
        b = np.einsum("bn,bni->bi", w, target) / total
        da, db = source - a[:, None], target - b[:, None]
        spread = np.einsum("bn,bni,bnj->bij", w, da, da) / total[..., None]
        cross = np.einsum("bn,bni,bnj->bij", w, db, da) / total[..., None]
        linear = _turned(prior[:, :, :3], cross, spread)
        hold = RIDGE * np.trace(spread, axis1=1, axis2=2)[:, None, None] / 3.0 + 1e-30
        solved = np.linalg.solve(
            spread + hold * np.eye(3), np.swapaxes(cross + hold * linear, 1, 2)
        )  # symmetric: the transposed equation
        A = np.swapaxes(solved, 1, 2)
        current = np.concatenate([A, (b - np.einsum("bij,bj->bi", A, a))[..., None]], axis=2)
        if turn == ROUNDS - 1:
            break
        error = np.linalg.norm(apply(current[:, None], source) - target, axis=2)
        scale = np.maximum(2.0 * _weighted_median(error, base), 1e-9 * np.sqrt(hold[..., 0]))
        w = base / np.square(1.0 + np.square(error / scale))
    empty = base.sum(axis=1) <= 0
    return np.where(empty[:, None, None], prior, current)


def _turned(linear: Float64, cross: Float64, spread: Float64) -> Float64:
    """The prior's linear parts (B, 3, 3), turned by the rotation that fits them best to the pairs."""
    u, _, vt = np.linalg.svd(cross @ np.swapaxes(linear, 1, 2))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    turned: Float64 = u @ vt @ linear
    return turned


def _weighted_median(values: Float64, weights: Float64) -> Float64:
    """(B, 1) median of each row where weights are positive."""
    masked = np.where(weights > 0, values, np.inf)
    ordered = np.sort(masked, axis=1)
    middle = np.maximum((weights > 0).sum(axis=1) - 1, 0) // 2
    out = np.take_along_axis(ordered, middle[:, None], axis=1)
    return np.where(np.isfinite(out), out, 1.0)


def apply(maps: Affine, points: npt.NDArray[np.floating]) -> Float64:
    """Points (..., 3) under maps (..., 3, 4)."""
    moved: Float64 = (maps[..., :3] @ points.astype(np.float64)[..., None])[..., 0] + maps[..., 3]
    return moved


def warped(model: GaussianModel, maps: Affine) -> GaussianModel:
    """Gaussians moved by an affine map each: centres, and covariances as A Sigma A^T.

    Parameters
    ----------
    maps : (N, 3, 4) float64

    Returns
    -------
    GaussianModel
        Log scales in descending order; quaternions and colours as they were, so no use for rendering.
    """
    axes = (maps[:, :, :3] @ quaternion_to_rotation(model.quats)) * np.exp(model.log_scales.astype(np.float64))[:, None]
    squares = np.linalg.eigvalsh(axes @ np.swapaxes(axes, 1, 2))
    return model.with_(means=apply(maps, model.means), log_scales=0.5 * np.log(np.maximum(squares[:, ::-1], 1e-30)))


def blend(nodes: npt.NDArray[np.floating], maps: Affine, points: npt.NDArray[np.floating], near: int = 4) -> Affine:
    """Maps at points, from those at the nearest nodes.

    Parameters
    ----------
    nodes : (A, 3)
        Where maps are known.
    maps : (A, 3, 4) float64
    points : (N, 3)
    near : int
        Nodes that enter.

    Returns
    -------
    (N, 3, 4) float64
    """
    near = min(near, len(nodes))
    distance, index = cKDTree(nodes).query(points, k=near, workers=2)
    distance, index = distance.reshape(-1, near), index.reshape(-1, near)
    reach = np.maximum(distance[:, -1:], 1e-30)
    weights = np.square(1.0 - np.square(0.999 * distance / reach))
    weights /= weights.sum(axis=1, keepdims=True)
    out: Affine = np.einsum("nk,nkij->nij", weights, maps[index])
    return out


def unturned(deviations: Deviations) -> Deviations:
    """The same without rotations: which axis of a deformed ellipsoid was which, nobody knows."""
    return replace(deviations, rotation=np.inf)
