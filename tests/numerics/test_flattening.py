"""Flattened Gaussians keep their two largest axes, as covariances."""

from __future__ import annotations

import numpy as np
import pytest

from engine.compress.pruning import covariances
from engine.model import DISC_THICKNESS, GaussianModel
from engine.numerics.gaussians import flatten


def random_model(count: int) -> GaussianModel:
    rng = np.random.default_rng(0)
    quats = rng.standard_normal((count, 4))
    return GaussianModel(
        rng.standard_normal((count, 3)),
        rng.normal(-3, 1, (count, 3)),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        rng.standard_normal(count),
        rng.standard_normal((count, 4, 3)),
    )


def test_the_smallest_axis_goes_and_nothing_else() -> None:
    model = random_model(300)
    assert set(model.log_scales.argmin(axis=1)) == {0, 1, 2}
    discs = flatten(model)
    assert discs.is_flat
    before, after = covariances(model), covariances(discs)
    values, vectors = np.linalg.eigh(before)
    expected = np.einsum("nij,nj,nkj->nik", vectors[:, :, 1:], values[:, 1:], vectors[:, :, 1:])
    np.testing.assert_allclose(after, expected, atol=2e-6 * values[:, 2, None, None].max())
    np.testing.assert_allclose(np.linalg.norm(discs.quats, axis=1), 1.0, atol=1e-6)
    thinness = discs.scales[:, 2] / discs.scales[:, :2].min(axis=1)
    np.testing.assert_allclose(thinness, DISC_THICKNESS, rtol=1e-5)
    for name in ("means", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(discs, name), getattr(model, name))


@pytest.mark.parametrize("times", [2, 3])
def test_discs_stay_as_they_are(times: int) -> None:
    once = flatten(random_model(50))
    again = once
    for _ in range(times - 1):
        again = flatten(again)
    np.testing.assert_allclose(again.log_scales, once.log_scales, atol=1e-6)
    np.testing.assert_array_equal(again.quats, once.quats)
