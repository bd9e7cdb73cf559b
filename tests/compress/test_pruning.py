from __future__ import annotations

import numpy as np
import pytest

from engine.compress.cells import split_cells
from engine.compress.impact import ranks
from engine.compress.pruning import PruneConfig, adaptive_keep, drop_unseen_bands, merge_duplicates, prune, prune_at
from engine.errors import InputError
from engine.model import GaussianModel


def model(n: int = 4000, degree: int = 0) -> GaussianModel:
    rng = np.random.default_rng(0)
    return GaussianModel(
        rng.uniform(-1, 1, (n, 3)),
        np.full((n, 3), -4.0),
        np.tile([1.0, 0, 0, 0], (n, 1)),
        np.zeros(n),
        rng.standard_normal((n, (degree + 1) ** 2, 3)),
    )


def quality_by_mass(impact: np.ndarray, full: GaussianModel):  # type: ignore[no-untyped-def]
    """A stand-in renderer: PSNR falls with the squared impact that is gone."""
    value = {tuple(mean): float(v) for mean, v in zip(full.means, impact, strict=True)}
    total = sum(value.values())

    def measure(candidate: GaussianModel) -> float:
        left = sum(value.get(tuple(mean), 0.0) for mean in candidate.means)
        return float(-10 * np.log10(max(1 - left / total, 1e-9)))

    return measure


@pytest.mark.parametrize("budget", [10.0, 20.0, 30.0])
def test_the_budget_is_met_from_above(budget: float) -> None:
    full = model()
    impact = np.random.default_rng(1).gamma(0.3, 1.0, len(full))
    result = prune(full, impact, quality_by_mass(impact, full), 1.0, PruneConfig(budget_db=budget, merge_distance=0))
    assert budget <= result.psnr_db <= budget + 0.3
    assert len(result.model) == len(result.kept) < len(full)
    np.testing.assert_array_equal(result.model.means, full.means[result.kept])


def test_no_budget_keeps_everything() -> None:
    full = model()
    result = prune(full, np.ones(len(full)), lambda _: 0.0, 1.0, PruneConfig())
    assert result.model is full


def test_equation_5_cuts_redundant_clusters_harder() -> None:
    rank = np.arange(1, 101) / 100
    clusters = (np.arange(100) >= 50).astype(np.int32)  # cluster 0 holds the low half
    keep = adaptive_keep(rank, clusters, tau_base=0.3, gamma=0.2)
    # cluster 0: 29 of 50 below 0.3, so tau = 0.3 + 0.2 * 0.58; cluster 1: nothing below, tau = 0.3.
    assert keep[:50].sum() == int((rank[:50] >= 0.3 + 0.2 * 0.58).sum())
    assert keep[50:].all()


def test_unneeded_bands_go_first_and_within_the_error() -> None:
    full = model(500, degree=2)
    curvature = np.ones((500, 9), np.float32)
    curvature[:250, 1:] = 1e-6  # no view shows the higher bands of the first half
    thin, dropped = drop_unseen_bands(full, curvature, pixels=1000, error_budget=1e-4)
    assert dropped >= 250 * 8
    assert not thin.sh[:250, 1:].any()
    np.testing.assert_array_equal(thin.sh[:, 0], full.sh[:, 0])
    assert (thin.sh[250:, 1:] != 0).mean() > 0.9
    untouched, none = drop_unseen_bands(full, curvature, 1000, 0.0)
    assert none == 0
    np.testing.assert_array_equal(untouched.sh, full.sh)


def test_bands_take_a_tenth_of_the_error_that_may_be_spent() -> None:
    """To second order each band costs curvature times its squared coefficients; errors of neighbours add up."""
    full = model(100, degree=1).with_(sh=np.ones((100, 4, 3), np.float32))
    curvature = np.full((100, 4), 2.0, np.float32)  # a band: 3 coefficients of 3 channels, 2 each, so 18
    _, dropped = drop_unseen_bands(full, curvature, pixels=1000, error_budget=10.5 * 18 / (0.1 * 1000 * 3))
    assert dropped == 10 * 3


def with_twins(pairs: int, singles: int) -> GaussianModel:
    """Each of the first Gaussians is there twice; the second time at the end."""
    once = model(pairs + singles)
    return once.take(np.concatenate([np.arange(len(once)), np.arange(pairs)]))


def test_what_is_there_twice_is_merged_first() -> None:
    full = with_twins(pairs=50, singles=150)
    found = prune(full, np.ones(250), lambda m: 60.0 if len(m) >= 200 else 0.0, 1.0, PruneConfig(budget_db=30.0))
    assert found.merged == 50
    assert found.kept.tolist() == list(range(200))
    apart = prune(full, np.ones(250), lambda m: 60.0, 1.0, PruneConfig(budget_db=30.0, merge_distance=0.0))
    assert apart.merged == 0


def test_merging_that_eats_a_third_of_the_error_is_left() -> None:
    full = with_twins(pairs=50, singles=150)
    found = prune(full, np.ones(250), lambda m: 60.0 if len(m) == 250 else 33.0, 1.0, PruneConfig(budget_db=30.0))
    assert found.merged == 0


def test_a_merged_pair_counts_for_both() -> None:
    """Each half weighs less than a single one, the two together more."""
    full = with_twins(pairs=50, singles=100)
    weight = np.concatenate([np.full(50, 0.6), np.ones(100), np.full(50, 0.6)])
    found = prune(full, weight, lambda m: 40.0 if len(m) >= 75 else 0.0, 1.0, PruneConfig(budget_db=30.0))
    assert found.merged == 50
    assert 75 <= len(found.kept) < 150
    assert set(range(50)) <= set(found.kept.tolist())


def test_gamma_cuts_where_much_is_redundant() -> None:
    """Two halves of a scene, one mostly of little impact: with gamma more of that half goes, less of the other."""
    full = model()
    poor = full.means[:, 0] < 0
    impact = np.random.default_rng(4).uniform(0.0, 1.0, len(full)) * np.where(poor, 0.6, 1.0)
    measure = quality_by_mass(impact, full)
    kept = {}
    for gamma in (0.0, 0.4):
        config = PruneConfig(budget_db=8.0, gamma=gamma, clusters=2, merge_distance=0)
        rows = prune(full, impact, measure, 1.0, config).kept
        kept[gamma] = (poor[rows].sum() / poor.sum(), (~poor)[rows].sum() / (~poor).sum())
    assert kept[0.4][0] < kept[0.0][0] - 0.02
    assert kept[0.4][1] > kept[0.0][1] + 0.02


def test_a_fixed_threshold_is_equation_5_once_then_merging() -> None:
    full = model(2000)
    twice = np.concatenate([np.arange(2000), np.arange(0, 2000, 2)])
    full = full.take(twice)  # every second one is there twice
    impact = np.random.default_rng(1).gamma(0.3, 1.0, len(full))
    impact[2000:] = impact[:2000:2]
    impact[full.means[:, 0] < 0] *= 0.1  # a side that is mostly redundant
    config = PruneConfig(gamma=0.2, merge_distance=0.05, clusters=16)
    slim, kept, merged = prune_at(full, impact, 0.5, 2.0, config)
    clusters = split_cells((full.means / 2.0).astype(np.float32), np.ones(len(full)), 16)
    keep = adaptive_keep(ranks(impact), clusters, 0.5, 0.2)
    expected, rows, _ = merge_duplicates(full.take(keep), 0.05)
    assert merged == int(keep.sum()) - len(slim) > 50
    np.testing.assert_array_equal(slim.means, expected.means)
    np.testing.assert_array_equal(kept, np.flatnonzero(keep)[rows])
    assert len(prune_at(full, impact, 0.5, 2.0, PruneConfig(gamma=0.0, merge_distance=0.0))[0]) == 1501
    with pytest.raises(InputError, match="prunes everything"):
        prune_at(full, impact, 1.5, 2.0, config)
