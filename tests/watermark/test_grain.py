"""The grain: what it moves, by how much, and what it leaves."""

from __future__ import annotations

import numpy as np

from engine.model import DISC_THICKNESS, GaussianModel
from engine.watermark.config import CONFIG
from engine.watermark.grain import ATTRIBUTES, Grain, roughen, thin, units
from tests.reference.grain import rotation_of, roughened


def blobs(count: int = 500, seed: int = 0) -> GaussianModel:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return GaussianModel(
        rng.normal(size=(count, 3)).astype(np.float32),
        rng.normal(-4.0, 1.0, (count, 3)).astype(np.float32),
        quats.astype(np.float32),
        rng.normal(size=count).astype(np.float32),
        rng.normal(size=(count, 1, 3)).astype(np.float32),
    )


def signs_for(model: GaussianModel, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).choice([-1.0, 1.0], (len(model), ATTRIBUTES)).astype(np.float32)


def test_every_centre_moves_along_its_own_axes_and_every_size_by_a_step() -> None:
    model, grain = blobs(), Grain(0.05, 0.02)
    signs = signs_for(model)
    rough = roughen(model, grain, signs)
    for i in range(20):
        scales = np.exp(model.log_scales[i].astype(float))
        along = rotation_of(model.quats[i].astype(float)).T @ (rough.means[i] - model.means[i].astype(float))
        reach = 0.05 * np.maximum(scales, CONFIG.grain.flat * np.sort(scales)[1])
        np.testing.assert_allclose(along, reach * signs[i, :3], atol=1e-6)
    np.testing.assert_allclose(rough.log_scales - model.log_scales, 0.02 * signs[:, 3:], atol=1e-6)
    for name in ("quats", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(rough, name), getattr(model, name))


def test_what_is_displaced_is_that_of_the_slow_twin() -> None:
    model, grain = blobs(), Grain(0.3, 0.2)
    signs = signs_for(model)
    rough = roughen(model, grain, signs)
    means, log_scales = roughened(model, grain.center, grain.scale, signs)
    np.testing.assert_allclose(rough.means, means, atol=1e-6)
    np.testing.assert_allclose(rough.log_scales, log_scales, atol=1e-6)


def test_a_sheet_moves_through_its_thickness_by_a_share_of_its_width() -> None:
    flat = np.log(np.array([[0.1, 0.001, 0.2]], dtype=np.float32))
    np.testing.assert_allclose(units(flat), [[0.1, CONFIG.grain.flat * 0.1, 0.2]], rtol=1e-5)


def test_a_disc_keeps_its_thickness() -> None:
    model = blobs()
    logs = np.sort(model.log_scales, axis=1)
    logs[:, 0] = logs[:, 1] + np.log(DISC_THICKNESS)
    model = model.with_(log_scales=logs)
    assert thin(logs).tolist() == [[True, False, False]] * len(model)
    rough = roughen(model, Grain(0.05, 0.02), signs_for(model))
    np.testing.assert_array_equal(rough.log_scales[:, 0], model.log_scales[:, 0])
    assert (rough.log_scales[:, 1:] != model.log_scales[:, 1:]).all()


def test_no_grain_has_no_chips() -> None:
    assert (Grain().there, Grain().chips(10)) == (False, 0)
    assert (Grain(0.0, 0.1).there, Grain(0.05, 0.0).chips(10)) == (True, 60)
    assert Grain(0.05, 0.02).times(0.5) == Grain(float(np.float32(0.025)), float(np.float32(0.01)))
