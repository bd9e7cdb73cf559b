"""A small solid object to attack, and a picture with texture, edges and flat parts."""

from __future__ import annotations

import numpy as np
import pytest

from engine.lab.sim.attack import Attack
from engine.model import Float32, GaussianModel


@pytest.fixture(scope="session")
def model() -> GaussianModel:
    """500 overlapping Gaussians on an ellipsoid away from the origin, SH degree 2, no two alike."""
    rng = np.random.default_rng(7)
    n = 500
    normal = rng.standard_normal((n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    means = np.array([3.0, -1.0, 5.0]) + normal * [1.0, 0.7, 1.4]
    quats = rng.standard_normal((n, 4))
    sh = 0.15 * rng.standard_normal((n, 9, 3))
    sh[:, 0] = 0.8 * np.sin(3 * normal + [0, 1, 2]) + 0.2 * rng.standard_normal((n, 3))
    return GaussianModel(
        means.astype(np.float32),
        np.log(rng.uniform(0.04, 0.14, (n, 3))).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.normal(0.5, 1.5, n).astype(np.float32),
        sh.astype(np.float32),
    )


@pytest.fixture(scope="session")
def image() -> Float32:
    """(72, 96, 3), mid-tones so that small changes are not clipped away."""
    rng = np.random.default_rng(8)
    y, x = np.mgrid[:72, :96]
    waves = np.stack([np.sin(x / (4 + c)) * np.cos(y / (6 - c)) for c in range(3)], axis=-1)
    picture = 0.5 + 0.2 * waves + 0.03 * rng.standard_normal(waves.shape)
    picture[10:30, 20:50] = [0.7, 0.3, 0.5]
    return np.clip(picture, 0.02, 0.98).astype(np.float32)


@pytest.fixture
def target(request: pytest.FixtureRequest, attack: Attack) -> GaussianModel | Float32:
    return request.getfixturevalue(attack.kind)
