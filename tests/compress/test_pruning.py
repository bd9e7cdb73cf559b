from __future__ import annotations

import numpy as np
import pytest

from engine.compress.impact import spatial_coherence, uncertainty
from engine.compress.pruning import PruneConfig, adaptive_keep, drop_unseen_bands, prune
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
    curvature[:250, 1:] = 1e-6  # nobody looks at the higher bands of the first half
    thin, dropped = drop_unseen_bands(full, curvature, pixels=1000, error_budget=1e-4)
    assert dropped >= 250 * 8
    assert not thin.sh[:250, 1:].any()
    np.testing.assert_array_equal(thin.sh[:, 0], full.sh[:, 0])
    assert (thin.sh[250:, 1:] != 0).mean() > 0.9
    untouched, none = drop_unseen_bands(full, curvature, 1000, 0.0)
    assert none == 0
    np.testing.assert_array_equal(untouched.sh, full.sh)


def test_coherence_and_uncertainty() -> None:
    means = np.concatenate([np.random.default_rng(2).uniform(-1, 1, (500, 3)), [[50.0, 0, 0]]])
    one = model(501).with_(means=means)
    coherence = spatial_coherence(one)
    assert coherence[-1] < 1e-6 < 0.3 < np.median(coherence[:-1])
    u = uncertainty(np.array([0.0, 1.0, 100.0]))
    assert (np.diff(u) < 0).all()
