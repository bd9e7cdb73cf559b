"""Splitting: who is split, and that the two halves are what the whole was."""

from __future__ import annotations

import numpy as np

from engine.flows.embed.config import CONFIG
from engine.flows.embed.delivery import densify
from engine.model import GaussianModel
from engine.numerics.gaussians import covariances
from tests.raster.scenes import random_model


def halves(model: GaussianModel, worth: np.ndarray, share: float) -> tuple[GaussianModel, np.ndarray]:
    """The densified model, and the rows that were split."""
    made = densify(model, worth, share)
    return made, np.flatnonzero((made.means[: len(model)] != model.means).any(axis=1))


def test_those_of_the_greatest_worth_are_split() -> None:
    model, worth = random_model(50, 2, 4), np.random.default_rng(0).random(50)
    made, rows = halves(model, worth, 0.2)
    assert len(made) == 60
    assert set(rows) == set(np.argsort(worth)[-10:])
    np.testing.assert_array_equal(made.sh[50:], model.sh[rows])
    rest = np.setdiff1d(np.arange(50), rows)
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(made, name)[rest], getattr(model, name)[rest])
    assert densify(model, worth, 0.0) is model


def test_both_halves_have_the_moments_and_the_opacity_of_the_whole() -> None:
    model = random_model(50, 2, 4)
    model = model.with_(quats=model.quats / np.linalg.norm(model.quats, axis=1, keepdims=True))
    made, rows = halves(model, np.arange(50.0), 0.3)
    first, second = made.take(rows), made.take(np.arange(50, len(made)))
    np.testing.assert_allclose(0.5 * (first.means + second.means), model.means[rows], atol=1e-5)
    gap = 0.5 * (first.means - second.means).astype(np.float64)
    np.testing.assert_allclose(
        covariances(first) + gap[:, :, None] * gap[:, None, :], covariances(model.take(rows)), rtol=1e-3, atol=1e-7
    )
    np.testing.assert_array_equal(first.opacities, second.opacities)
    np.testing.assert_allclose(1 - (1 - first.opacities) ** 2, model.opacities[rows], atol=1e-5)
    longest = np.exp(model.log_scales[rows].max(axis=1))
    np.testing.assert_allclose(np.linalg.norm(gap, axis=1), CONFIG.plan.apart * longest, rtol=1e-4)
