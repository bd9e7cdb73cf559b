"""What other people's programs do to a model, written from their formats' sides and not with our functions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from engine.formats import read_model, write_model
from engine.model import ATTRIBUTES, GaussianModel


def resaved(model: GaussianModel, format: str, folder: Path) -> GaussianModel:
    """The model written to a file of a trade format, and read again."""
    path = folder / f"resaved.{format}"
    write_model(model, path)
    return read_model(path).model


def moved_elsewhere(
    model: GaussianModel, scale: float, euler: tuple[float, float, float], shift: tuple[float, float, float]
) -> GaussianModel:
    """Turned (x, y, z, degrees), scaled and shifted in single precision; harmonics left as they were, which many
    programs do, and opacities, too."""
    turn = Rotation.from_euler("xyz", euler, degrees=True)
    *vector, w = turn.as_quat().astype(np.float32)
    own_w, own = model.quats[:, :1], model.quats[:, 1:]
    scalar = w * own_w - (own @ vector)[:, None]
    quats = np.concatenate([scalar, w * own + own_w * vector + np.cross(vector, own)], axis=1)
    matrix = np.float32(scale) * turn.as_matrix().astype(np.float32)
    return model.with_(
        means=model.means @ matrix.T + np.float32(shift),
        log_scales=model.log_scales + np.float32(np.log(scale)),
        quats=quats / np.linalg.norm(quats, axis=1, keepdims=True),
    )


def along_a_curve(means: np.ndarray) -> np.ndarray:
    """Order along a Morton curve of 10 bits an axis over the bounding box, as files are sorted for packing."""
    low, high = means.min(axis=0), means.max(axis=0)
    cells = np.minimum((1024 * ((means - low) / np.maximum(high - low, 1e-30))).astype(np.int64), 1023)
    code = np.zeros(len(means), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def merged_to(model: GaussianModel, share: float, seed: int = 0) -> GaussianModel:
    """Thinned by merging mutual nearest pairs, in colour, too, round after round: mass, mean and covariance of a pair
    are kept, the merged opacity is what its mass leaves."""
    rng = np.random.default_rng(seed)
    left = round(share * len(model))
    while len(model) > left:
        looks = np.concatenate([model.means / model.means.std(), 0.5 * model.sh[:, 0]], axis=1)
        near = cKDTree(looks).query(looks, k=2)[1][:, 1]
        mutual = np.flatnonzero((near[near] == np.arange(len(model))) & (np.arange(len(model)) < near))
        first = rng.permutation(mutual)[: len(model) - left]
        model = _merged(model, first, near[first])
    return model


def _merged(model: GaussianModel, first: np.ndarray, second: np.ndarray) -> GaussianModel:
    a, b = model.take(first), model.take(second)
    mass_a, mass_b = _mass(a), _mass(b)
    wa, wb = (mass_a / (mass_a + mass_b))[:, None], (mass_b / (mass_a + mass_b))[:, None]
    mean = wa * a.means + wb * b.means
    spread = sum(
        w[:, :, None] * (_covariance(m) + (m.means - mean)[:, :, None] * (m.means - mean)[:, None])
        for w, m in ((wa, a), (wb, b))
    )
    values, axes = np.linalg.eigh(spread)
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    log_scales = 0.5 * np.log(np.maximum(values, 1e-20))
    opacity = np.clip((mass_a + mass_b) / np.exp(log_scales[:, 1] + log_scales[:, 2]), 0.004, 0.996)
    new = GaussianModel(
        mean,
        log_scales,
        np.roll(Rotation.from_matrix(axes).as_quat(), 1, axis=1),
        np.log(opacity / (1 - opacity)),
        wa[:, None] * a.sh + wb[:, None] * b.sh,
    )
    rest = model.take(np.setdiff1d(np.arange(len(model)), np.concatenate([first, second])))
    names = ATTRIBUTES
    return GaussianModel(*(np.concatenate([getattr(rest, name), getattr(new, name)]) for name in names))


def _mass(model: GaussianModel) -> np.ndarray:
    scales = np.sort(model.log_scales.astype(float), axis=1)
    return model.opacities.astype(float) * np.exp(scales[:, 1] + scales[:, 2])


def _covariance(model: GaussianModel) -> np.ndarray:
    axes = Rotation.from_quat(np.roll(model.quats, -1, axis=1)).as_matrix() * np.exp(model.log_scales)[:, None]
    return axes @ np.swapaxes(axes, 1, 2)
