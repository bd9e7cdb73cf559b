from __future__ import annotations

import numpy as np
import pytest

from engine.compress.hvq import HvqConfig, assign, decode_stages, detail_metric, group_means, quantize
from engine.model import GaussianModel


def patchy_model(n: int = 6000, degree: int = 1, seed: int = 1) -> GaussianModel:
    rng = np.random.default_rng(seed)
    means = rng.uniform(-1, 1, (n, 3))
    colors = np.sin(3 * means @ rng.standard_normal((3, 3)))
    sh = rng.standard_normal((n, (degree + 1) ** 2, 3)) * 0.05
    sh[:, 0] = colors + 0.1 * rng.standard_normal((n, 3))
    quats = np.tile([1.0, 0, 0, 0], (n, 1))
    return GaussianModel(means, np.full((n, 3), -4.0), quats, np.zeros(n), sh)


def test_each_stage_lowers_the_error_and_all_codes_live() -> None:
    model = patchy_model()
    stages = quantize(model, np.ones(len(model)), 1.0, HvqConfig(cells=256, residual_codes=(128, 128)))
    errors = [float(((model.sh - decode_stages(stages[: k + 1])) ** 2).mean()) for k in range(len(stages))]
    assert errors[0] > 1.4 * errors[1] > 1.4 * 1.2 * errors[2]
    for stage in stages[1:]:
        assert (np.bincount(stage.labels, minlength=len(stage.codebook)) > 0).mean() > 0.9


def test_stage_zero_code_vector_is_the_weighted_mean_of_its_members() -> None:
    model = patchy_model(500)
    weights = np.random.default_rng(0).gamma(1.0, 1.0, len(model))
    stage = quantize(model, weights, 1.0, HvqConfig(cells=16, residual_codes=()))[0]
    flat = model.sh.reshape(len(model), -1)
    for code in range(len(stage.codebook)):
        inside = stage.labels == code
        expected = np.average(flat[inside], axis=0, weights=weights[inside])
        np.testing.assert_allclose(stage.codebook[code], expected, atol=1e-5)


def test_same_input_same_codes() -> None:
    model = patchy_model(2000)
    config = HvqConfig(cells=64, residual_codes=(64,))
    a, b = (quantize(model, np.ones(len(model)), 1.0, config) for _ in range(2))
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x.labels, y.labels)
        np.testing.assert_array_equal(x.codebook, y.codebook)


def test_assign_is_the_nearest_code() -> None:
    rng = np.random.default_rng(2)
    x, book = rng.standard_normal((700, 12), np.float32), rng.standard_normal((50, 12), np.float32)
    brute = ((x[:, None] - book[None]) ** 2).sum(axis=2).argmin(axis=1)
    np.testing.assert_array_equal(assign(x, book, chunk=64), brute)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_metric_is_equation_7(coefficients: int) -> None:
    rng = np.random.default_rng(3)
    g, c = rng.standard_normal((2, 5, coefficients * 3)).astype(np.float32)
    lam = 0.3
    gap = (g - c).reshape(5, coefficients, 3).astype(np.float64)
    even = coefficients // 2 * 2
    detail = (gap[:, 0:even:2] - gap[:, 1:even:2]) * np.sqrt(0.5)
    expected = (gap**2).sum(axis=(1, 2)) + lam * (detail**2).sum(axis=(1, 2))
    got = ((detail_metric(g, lam) - detail_metric(c, lam)).astype(np.float64) ** 2).sum(axis=1)
    np.testing.assert_allclose(got, expected, rtol=1e-5)


def test_group_means_of_unweighted_members_is_their_plain_mean() -> None:
    values = np.arange(12, dtype=np.float64).reshape(4, 3)
    means = group_means(values, np.array([0, 0, 1, 1], np.int32), np.array([1.0, 1.0, 0.0, 0.0]))
    np.testing.assert_allclose(means[1], values[2:].mean(axis=0), rtol=1e-6)
