from __future__ import annotations

import numpy as np
import pytest

from engine.compress.hvq import Stage
from engine.compress.impact import Impact
from engine.model import SH_C0
from engine.watermark.config import CONFIG
from engine.watermark.planning import PlanConfig, capacity_bits, make_plan, predict_z


def scene(views: int = 3, n: int = 6000, codes: int = 256, seed: int = 0) -> tuple[tuple[Stage, ...], Impact]:
    rng = np.random.default_rng(seed)
    labels = (np.arange(n) % codes).astype(np.int32)
    book = rng.standard_normal((codes, 3)).astype(np.float32)
    per_view = rng.gamma(1.0, 2.0, (views, n)).astype(np.float32)
    per_view[0, labels < codes // 2] *= 0.05  # the first view sees little of one half
    coverage = per_view.sum(axis=0, dtype=np.float64)
    busy = coverage * rng.uniform(0.01, 0.1, codes)[labels]
    return (Stage(book, labels),), Impact(coverage, per_view, busy, 0.3 * coverage)


def test_amplitudes_have_the_common_median_and_are_positive() -> None:
    plan = make_plan(*scene())
    assert np.median(plan.layout.amplitudes) == pytest.approx(CONFIG.planning.mark_scale, rel=1e-5)
    assert (plan.layout.amplitudes > 0).all()


def test_where_nothing_is_missed_amplitudes_are_usual() -> None:
    """A model in one colour: what its neighbours do not tell is nothing, or by rounding less than nothing."""
    stages, impact = scene()
    missed = np.tile(-1e-20 * np.eye(3), (len(stages[0].codebook), 1, 1))
    plan = make_plan(stages, impact, PlanConfig(), missed=missed)
    assert np.isfinite(plan.layout.amplitudes).all()
    assert (plan.layout.amplitudes > 0).all()


def test_keyed_jitter_multiplies_amplitudes() -> None:
    """Who knows the public plan alone must not know the amplitudes: every chip has a factor of its own."""
    stages, impact = scene()
    factors = np.random.default_rng(9).uniform(0.5, 2.0, 3 * len(stages[0].codebook))
    plain, shaken = make_plan(stages, impact), make_plan(stages, impact, jitter=lambda chips: factors[:chips])
    ratio = shaken.layout.amplitudes / plain.layout.amplitudes / factors
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-5)
    energy = shaken.energies / plain.energies / factors**2
    np.testing.assert_allclose(energy, energy[0, 0], rtol=1e-5)


def test_colors_that_are_hard_to_guess_carry_more_within_limits() -> None:
    stages, impact = scene()
    off = np.array([1.0, 2.0, 1.0, 0.5, 1.0, 100.0, 1.0, 0.001])[np.arange(len(stages[0].codebook)) % 8]
    missed = np.square(off)[:, None, None] * np.eye(3)
    config = PlanConfig(surprise_exponent=0.5)
    plain, guessed = make_plan(stages, impact, config), make_plan(stages, impact, config, missed=missed)
    ratio = (guessed.layout.amplitudes / plain.layout.amplitudes).reshape(-1, 3)
    expected = np.sqrt([1.0, 2.0, 1.0, 0.5, 1.0, 4.0, 1.0, 0.2])  # the last two at the limits
    np.testing.assert_allclose(ratio[:8] / ratio[0], np.repeat(expected[:, None], 3, axis=1), rtol=1e-5)


def test_a_carrier_along_which_colors_hardly_vary_moves_no_more_than_hides() -> None:
    """Gray stone: what its neighbours do not tell of a color is luma."""
    stages, impact = scene()
    codes = len(stages[0].codebook)
    direction = make_plan(stages, impact).layout.directions[0]

    def shown(along: list[float]) -> np.ndarray:
        missed = np.tile((direction.T * np.square(along)) @ direction, (codes, 1, 1))
        plan = make_plan(stages, impact, PlanConfig(), missed=missed)
        return np.abs(plan.layout.split(plan.layout.amplitudes)[0]).mean(axis=0) / along

    free, gray = shown([1.0, 1.0, 1.0]), shown([1.0, 1.0, 0.01])
    assert gray[1] / gray[0] == pytest.approx(free[1] / free[0], rel=0.05)
    assert free[2] < CONFIG.planning.hidden * free[0]
    assert gray[2] == pytest.approx(CONFIG.planning.hidden * gray[0], rel=0.05)


def test_views_get_about_the_same_energy() -> None:
    stages, impact = scene()
    energy = make_plan(stages, impact).energies.sum(axis=1)
    flat = np.array([np.bincount(stages[0].labels, view).sum() for view in impact.per_view])
    assert energy.max() / energy.min() < 1.3 < flat.max() / flat.min()


def test_texture_gets_more() -> None:
    stages, impact = scene()
    texture = np.bincount(stages[0].labels, impact.busy) / np.bincount(stages[0].labels, impact.coverage)
    luma = make_plan(stages, impact).layout.amplitudes.reshape(-1, 3)[:, 0]
    busy, smooth = texture > np.quantile(texture, 0.8), texture < np.quantile(texture, 0.2)
    assert luma[busy].mean() > 1.2 * luma[smooth].mean()


def test_predicted_z_grows_with_strength_and_falls_with_bits() -> None:
    plan = make_plan(*scene())
    bit_of = (np.arange(plan.layout.chips) // 3 % 32).astype(np.int32)
    weak, strong = (predict_z(plan.times(s).energies, bit_of, 32).mean() for s in (0.05, 0.2))
    assert strong > 1.5 * weak
    more = predict_z(plan.times(0.2).energies, (np.arange(plan.layout.chips) // 3 % 64).astype(np.int32), 64).mean()
    assert more < 0.8 * strong


def test_prediction_agrees_with_simulated_reading() -> None:
    """The reference channel simulated: y of each chip is its energy times sign plus white noise."""
    rng = np.random.default_rng(3)
    chips, bits, sigma = 4096, 32, 0.05
    energy = rng.gamma(4.0, 0.25, (1, chips)) * 4e-4
    bit_of = (np.arange(chips) % bits).astype(np.int32)
    expected = predict_z(energy, bit_of, bits)[0].mean()
    observed = []
    for _ in range(60):
        y = energy[0] + np.sqrt(energy[0]) * sigma * rng.standard_normal(chips)
        total, norm = np.bincount(bit_of, y), np.sqrt(np.bincount(bit_of, y**2))
        observed.append((total / norm).mean())
    assert np.mean(observed) == pytest.approx(expected, rel=0.05)


def test_capacity_is_where_bits_get_their_least_z() -> None:
    plan = make_plan(*scene()).times(3.0)
    capacity = capacity_bits(plan.energies, plan.layout.chips)
    bit_of = (np.arange(plan.layout.chips) // 3 % capacity).astype(np.int32)
    if capacity < plan.layout.chips / 16 - 1:
        z = np.median(predict_z(plan.energies, bit_of, capacity).mean(axis=1))
        assert z == pytest.approx(CONFIG.planning.bit_z, rel=0.15)
    assert capacity_bits(plan.times(1e-6).energies, plan.layout.chips) == 0


def test_energies_are_those_of_the_amplitudes() -> None:
    """What a chip adds to a view, squared: its cell's pixels times the square of its colour there."""
    stages, impact = scene()
    plan = make_plan(stages, impact)
    coverage = np.stack([np.bincount(stages[0].labels, view) for view in impact.per_view])  # (V, M)
    expected = coverage[:, :, None] * (SH_C0 * plan.layout.amplitudes.reshape(-1, 3)) ** 2
    np.testing.assert_allclose(plan.energies, expected.reshape(3, -1), rtol=1e-4)


def test_residual_stages_get_their_share_of_the_energy() -> None:
    """Members of a residual code are strangers, so their energies add up and not their displacements."""
    (first,), impact = scene()
    rng = np.random.default_rng(5)
    second = Stage(rng.standard_normal((64, 3)).astype(np.float32), rng.integers(0, 64, 6000).astype(np.int32))
    plan = make_plan((first, second), impact, PlanConfig(stages=2, residual_share=0.1))
    base, rest = plan.energies[:, : 3 * 256], plan.energies[:, 3 * 256 :]
    assert rest.sum() / plan.energies.sum() == pytest.approx(0.1, rel=1e-6)
    assert base.sum() / plan.energies.sum() == pytest.approx(0.9, rel=1e-6)
    coverage = np.stack([np.bincount(second.labels, view) for view in impact.per_view])
    alone = np.bincount(second.labels, impact.squared) / np.bincount(second.labels, impact.coverage)
    amplitudes = plan.layout.amplitudes[3 * 256 :].reshape(-1, 3)
    expected = (coverage * alone)[:, :, None] * (SH_C0 * amplitudes) ** 2
    np.testing.assert_allclose(rest, expected.reshape(3, -1), rtol=1e-4)


def test_emphasis_scales_the_amplitudes_of_its_code_vectors() -> None:
    stages, impact = scene()
    unbalanced = PlanConfig(balance_rounds=0)
    quiet = stages[0].labels % 2 == 0
    plain = make_plan(stages, impact, unbalanced).layout.amplitudes
    ratio = make_plan(stages, impact, unbalanced, np.where(quiet, 0.5, 1.0)).layout.amplitudes / plain
    ratio = ratio.reshape(-1, 3)
    np.testing.assert_allclose(ratio[::2] / ratio[1::2], 0.5, rtol=1e-5)


def test_the_rarely_seen_carry_more() -> None:
    """The views are uncertain about them, and so is whoever looks."""
    stages, _ = scene()
    rare = stages[0].labels % 2 == 0
    factor = np.where(rare, 0.2, 1.0)
    coverage = np.full(6000, 5.0) * factor
    seen = Impact(coverage, (coverage / 3)[None].repeat(3, axis=0).astype(np.float32), 0.05 * coverage, coverage)
    luma = make_plan(stages, seen, PlanConfig(balance_rounds=0)).layout.amplitudes.reshape(-1, 3)
    assert luma[::2].mean() > 1.1 * luma[1::2].mean()


def test_a_bit_rests_on_enough_chips_whatever_the_strength() -> None:
    plan = make_plan(*scene())
    assert capacity_bits(plan.times(1e6).energies, 320) == 320 // CONFIG.planning.chips_per_bit
