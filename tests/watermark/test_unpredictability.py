"""What the surroundings leave unexplained: nothing on a smooth slope, the texture where there is some."""

from __future__ import annotations

import numpy as np

from engine.watermark.unpredictability import unexplained


def test_a_slope_is_explained_and_a_texture_is_not() -> None:
    rng = np.random.default_rng(0)
    centers = rng.uniform(-1, 1, (3_000, 3))
    slope = centers @ rng.normal(size=(3, 3)) + 0.5
    busy = centers[:, 0] > 0
    colors = slope + np.where(busy[:, None], 0.2, 0.0) * rng.normal(size=(3_000, 3)) * [1.0, 0.5, 0.0]
    missed = unexplained(centers, colors)
    inside, outside = missed[centers[:, 0] > 0.3], missed[centers[:, 0] < -0.6]
    np.testing.assert_allclose(np.mean(inside, axis=0).diagonal(), [0.042, 0.0105, 0.0], atol=2e-3)
    assert np.abs(outside).max() < 1e-4


def test_one_lucky_guess_is_not_taken_for_smoothness() -> None:
    rng = np.random.default_rng(1)
    centers = rng.uniform(-1, 1, (2_000, 3))
    energy = np.trace(unexplained(centers, rng.normal(size=(2_000, 3))), axis1=1, axis2=2)
    assert energy.min() > 0.2 * np.median(energy)


def test_few_code_vectors_explain_nothing() -> None:
    assert not unexplained(np.zeros((3, 3)), np.ones((3, 3))).any()
    assert np.isfinite(unexplained(np.zeros((40, 3)), np.ones((40, 3)))).all()
