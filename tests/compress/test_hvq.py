from __future__ import annotations

import numpy as np
import pytest

from engine.compress.hvq import (
    HvqConfig,
    _seed_odds,
    assign,
    decode_stages,
    detail_metric,
    group_means,
    learn_residual_stage,
    quantize,
)
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


def test_few_gaussians_get_few_codes() -> None:
    model = patchy_model(160)
    stages = quantize(model, np.ones(160), 1.0, HvqConfig(cells=4096, residual_codes=(1024,), min_members=8))
    assert len(stages[0].codebook) <= 160 / 8
    assert len(stages[1].codebook) == 160 // 4


def cloud(n: int = 4000, seed: int = 7) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((n, 12)).astype(np.float32)


def test_a_slow_average_keeps_its_codes_and_a_fast_one_follows() -> None:
    """lambda_d: the share of its past that a code keeps in each round; of 1 nothing is learnt after the first."""
    x, ones = cloud(), np.ones(4000)

    def learnt(decay: float, rounds: int) -> tuple[list[int], float]:
        stage = learn_residual_stage(x, ones, 64, HvqConfig(decay=decay, rounds=rounds), seed=1)
        return stage.labels.tolist(), float(((x - stage.decode()) ** 2).mean())

    first = learnt(1.0, 1)
    assert learnt(1.0, 6) == first
    slow, fast = learnt(0.8, 3), learnt(0.0, 3)
    assert fast[1] < slow[1] < first[1]


def test_lambda_freq_pays_for_detail_with_the_rest() -> None:
    """Eq 7: with the weight up, the detail of the residuals is met better and the smooth part worse."""
    x, ones = cloud(), np.ones(4000)
    errors = []
    for lambda_freq in (0.0, 3.0):
        stage = learn_residual_stage(x, ones, 128, HvqConfig(lambda_freq=lambda_freq), seed=1)
        gap = (x - stage.decode()).reshape(-1, 4, 3)
        left, right = gap[:, 0::2], gap[:, 1::2]
        errors.append((float(((left - right) ** 2).mean()), float(((left + right) ** 2).mean())))
    assert errors[1][0] < 0.9 * errors[0][0]
    assert errors[1][1] > 1.02 * errors[0][1]


def test_codes_go_where_errors_are_seen() -> None:
    """Half of the Gaussians are seen by no view (an uncertain colour weighs little): they get hardly a code."""
    x = cloud()
    x[2000:] += 20.0
    weights = np.where(np.arange(4000) < 2000, 1.0, 0.0)
    stage = learn_residual_stage(x, weights, 64, HvqConfig(), seed=1)
    assert len(np.unique(stage.labels[2000:])) < 0.25 * len(np.unique(stage.labels[:2000]))


def test_codes_that_nobody_uses_are_planted_anew() -> None:
    """Nine in ten have one colour, and so do most first codes: all but one of them would stay idle."""
    rng = np.random.default_rng(8)
    colors = 0.5 * rng.standard_normal((40, 12))
    x = np.concatenate([np.ones((3600, 12)), colors.repeat(10, axis=0)]).astype(np.float32)
    stage = learn_residual_stage(x, np.ones(4000), 64, HvqConfig(), seed=1)
    assert len(np.unique(stage.labels)) > 25
    assert float(((x - stage.decode()) ** 2).mean()) < 0.01


def test_new_codes_are_drawn_by_weight_and_squared_error() -> None:
    errors = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 2.0], [0, 0, 0]], np.float32)
    np.testing.assert_allclose(_seed_odds(errors, np.array([1.0, 3.0, 1.0, 9.0])), [1 / 8, 3 / 8, 4 / 8, 0], atol=1e-9)


def test_coarse_coefficients_are_left_to_stage_zero() -> None:
    model = patchy_model(2000)
    coarse = np.zeros((2000, 4), dtype=bool)
    coarse[:, 3] = True
    config = HvqConfig(cells=64, residual_codes=(64,))
    first, second = quantize(model, np.ones(2000), 1.0, config, coarse)
    assert not second.codebook.reshape(-1, 4, 3)[:, 3].any()
    whole = quantize(model, np.ones(2000), 1.0, config)
    np.testing.assert_array_equal(first.codebook, whole[0].codebook)
    assert whole[1].codebook.reshape(-1, 4, 3)[:, 3].any()
