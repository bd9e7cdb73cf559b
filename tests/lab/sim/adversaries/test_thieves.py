"""Thieves with several copies or one, and no key: what they recover from marks of the kind they were made for."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.attacks import image_attack, model_attack
from engine.model import SH_C0, Float32, GaussianModel
from engine.watermark.grain import Grain, roughen


@pytest.fixture(scope="module")
def original() -> GaussianModel:
    """Byte colors, sizes from a codebook."""
    rng = np.random.default_rng(1)
    n = 6000
    quats = rng.standard_normal((n, 4))
    codebook = np.sort(rng.uniform(-4.0, -1.0, 64))
    return GaussianModel(
        rng.standard_normal((n, 3)).astype(np.float32),
        rng.choice(codebook, (n, 3)).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.normal(0.5, 1.5, n).astype(np.float32),
        ((rng.integers(40, 216, (n, 1, 3)) / 255.0 - 0.5) / SH_C0).astype(np.float32),
    )


def copy_of(model: GaussianModel, seed: int, step: float, cells: int = 100) -> GaussianModel:
    rng = np.random.default_rng(seed)
    marked = roughen(model, Grain(2.5 * step, step), rng.choice([-1.0, 1.0], (len(model), 6)).astype(np.float32))
    moves = 0.02 * rng.standard_normal((cells, 3))
    return marked.with_dc(model.sh[:, 0] + moves[rng.integers(cells, size=len(model))])


def near(a: Float32, b: Float32) -> float:
    return float((np.abs(a - b) < 1e-4).mean())


def test_algebra_recovers_the_original_of_unequal_copies(original: GaussianModel) -> None:
    one, two = copy_of(original, 2, 0.0131), copy_of(original, 3, 0.0129)
    found = model_attack("algebra").apply(one, others=[two])
    for name in ("means", "log_scales", "sh"):
        assert near(getattr(found, name), getattr(original, name)) > 0.98
        assert near(getattr(one, name), getattr(original, name)) < 0.6


def test_algebra_takes_the_mean_where_differences_take_many_values(original: GaussianModel) -> None:
    rng = np.random.default_rng(4)
    shape = original.log_scales.shape
    one, two = (
        original.with_(log_scales=(original.log_scales + 0.02 * rng.standard_normal(shape)).astype(np.float32))
        for _ in range(2)
    )
    found = model_attack("algebra").apply(one, others=[two])
    np.testing.assert_allclose(found.log_scales, (one.log_scales + two.log_scales) / 2, atol=1e-6)


def test_push_clears_what_differs_and_drowns_what_agrees(original: GaussianModel) -> None:
    one, two = copy_of(original, 2, 0.013), copy_of(original, 3, 0.013)
    found = model_attack("push").apply(one, 10.0, others=[two], rng=1)
    differ = np.abs(one.log_scales - two.log_scales) > 0.01
    off = np.abs(found.log_scales - original.log_scales)
    assert off[differ].max() < 1e-4
    assert 0.1 < np.median(off[~differ]) < 0.16


def test_lattice_reads_the_codebook_behind_one_copy(original: GaussianModel) -> None:
    marked = copy_of(original, 2, 0.0131)
    found = model_attack("lattice").apply(marked, "geometry")
    assert near(found.log_scales, original.log_scales) > 0.95
    bell = marked.with_(log_scales=marked.log_scales + np.float32(0.01) * np.linspace(0, 1, len(marked))[:, None])
    np.testing.assert_array_equal(model_attack("lattice").apply(bell, "geometry").log_scales, bell.log_scales)


def test_chaff_is_as_many_as_said_and_never_drawn(original: GaussianModel) -> None:
    found = model_attack("chaff").apply(original, 3.0)
    assert len(found) == 4 * len(original)
    assert (found.opacities < 1 / 255).sum() >= 3 * len(original)


def test_motion_blur_keeps_light_and_loses_detail(image: Float32) -> None:
    blurred = image_attack("motion_blur").apply(image, 9.0, rng=2)
    assert blurred.mean() == pytest.approx(image.mean(), abs=0.01)
    assert np.abs(np.diff(blurred, axis=1)).mean() < 0.8 * np.abs(np.diff(image, axis=1)).mean()
    np.testing.assert_allclose(image_attack("motion_blur").apply(image, 0.0), image, atol=1e-6)


def test_copies_are_needed(original: GaussianModel) -> None:
    for name in ("algebra", "push"):
        with pytest.raises(InputError, match="other copies"):
            model_attack(name).apply(original)
