"""Scenes and what a thief does to them: material of the registration tests."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from engine.formats import read_model
from engine.model import SH_C0, GaussianModel
from engine.numerics.similarity import transform_model

TRAIN = Path(__file__).parents[1] / "data" / "train_1000.ply"
MOVES = {
    "small": (0.1, Rotation.random(random_state=1).as_matrix(), np.array([5.0, -3.0, 2.0])),
    "large": (10.0, Rotation.random(random_state=2).as_matrix(), np.array([-100.0, 0.0, 70.0])),
    "tiny": (2e-3, Rotation.random(random_state=3).as_matrix(), np.zeros(3)),
    "spz": (1.0, np.diag([1.0, -1.0, -1.0]), np.zeros(3)),
    "z-up": (1.0, np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.zeros(3)),
}


@cache
def scene(seed: int, n: int = 8_000, degree: int = 1) -> GaussianModel:
    """Clusters on a floor with walls, a colour and a size per cluster, as captured scenes have."""
    rng = np.random.default_rng(seed)
    k = 40
    label = rng.integers(k, size=n)
    centers = rng.normal(size=(k, 3)) * [4, 1, 4]
    means = centers[label] + rng.normal(size=(n, 3)) * rng.uniform(0.2, 1, (k, 3))[label]
    size = rng.normal(-4, 0.6, k)[label] + rng.normal(0, 0.5, n)
    log_scales = size[:, None] + rng.normal(0, 0.8, (n, 3)) * [1, 1, 1]
    quats = rng.normal(size=(n, 4))
    sh = rng.normal(0, 0.1, (n, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.normal(0, 0.8, (k, 3))[label] + rng.normal(0, 0.3, (n, 3))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return GaussianModel(means, log_scales, quats, rng.normal(0, 2, n), sh)


@cache
def train() -> GaussianModel:
    return read_model(TRAIN).model


def marked(model: GaussianModel, seed: int = 0) -> GaussianModel:
    """DC displaced as a strong mark displaces it."""
    rng = np.random.default_rng(seed)
    return model.with_dc(model.sh[:, 0] + rng.choice([-0.03, 0.03], (len(model), 3)))


def noised(model: GaussianModel, level: float, seed: int = 0) -> GaussianModel:
    """Every parameter off by `level` standard deviations of that parameter."""
    rng = np.random.default_rng(seed)

    def off(a: np.ndarray) -> np.ndarray:
        return a + level * a.std(axis=0) * rng.normal(size=a.shape)

    quats = off(model.quats)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return GaussianModel(off(model.means), off(model.log_scales), quats, off(model.opacity_logits), off(model.sh))


def splatted(model: GaussianModel) -> GaussianModel:
    """What a .splat file keeps: 8-bit colour, opacity and quaternion, no SH."""
    color = np.clip(np.round(255 * (0.5 + SH_C0 * model.sh[:, 0])), 0, 255) / 255
    alpha = np.clip(np.round(255 * model.opacities.astype(float)), 1, 254) / 255
    quats = np.clip(np.round(model.quats * 128), -128, 127) / 128
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    dc = (color - 0.5) / SH_C0
    return GaussianModel(model.means, model.log_scales, quats, np.log(alpha / (1 - alpha)), dc[:, None])


def rounded(model: GaussianModel) -> GaussianModel:
    """What SPZ and its like keep: positions in steps, log scales in sixteenths, 8-bit colour and opacity."""
    step = np.ptp(model.means, axis=0) / 2**16
    coarse = model.with_(means=np.round(model.means / step) * step, log_scales=np.round(model.log_scales * 16) / 16)
    return splatted(coarse)


def merged(a: GaussianModel, b: GaussianModel) -> GaussianModel:
    names = ("means", "log_scales", "quats", "opacity_logits", "sh")
    return GaussianModel(*(np.concatenate([getattr(a, k), getattr(b, k)]) for k in names))


def moved(model: GaussianModel, name: str = "small") -> GaussianModel:
    return transform_model(model, *MOVES[name])


def near(model: GaussianModel, share: float, seed: int = 0) -> np.ndarray:
    """The share of the model nearest to one of its Gaussians, shuffled."""
    rng = np.random.default_rng(seed)
    distance = np.linalg.norm(model.means - model.means[rng.integers(len(model))], axis=1)
    return rng.permutation(np.argsort(distance)[: int(share * len(model))])


def shuffled(model: GaussianModel, share: float = 1.0, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).permutation(len(model))[: int(share * len(model))]
