"""Which reference Gaussians a merged one is made of: right parts, right shares, trust where the moments agree."""

from __future__ import annotations

import numpy as np
import pytest

from engine.model import GaussianModel
from engine.numerics.gaussians import covariances, merge_groups, surface_mass
from engine.numerics.similarity import transform_model
from engine.numerics.umeyama import Similarity
from engine.registration.config import CONFIG
from engine.registration.mixtures import Mixtures, Parts, Wholes, likeliest_wholes, mix
from tests.reference import mixtures as twin


def apart(count: int, members: int = 3, seed: int = 0) -> tuple[GaussianModel, np.ndarray]:
    """Clusters of `members` Gaussians, far from each other, and the cluster of each."""
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(count), members)
    grid = np.stack(np.unravel_index(np.arange(count), (10, 10, 10)), axis=1)
    quats = rng.standard_normal((len(group), 4))
    return GaussianModel(
        (grid[group] + 0.05 * rng.standard_normal((len(group), 3))).astype(np.float32),
        np.log(rng.uniform(0.02, 0.08, (len(group), 3))).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.normal(-1.0, 1.0, len(group)).astype(np.float32),
        (0.3 * rng.standard_normal((len(group), 1, 3))).astype(np.float32),
    ), group.astype(np.int64)


def nobody(count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full(count, -1, np.int32), np.zeros(count, np.float32)


@pytest.mark.parametrize("compiled", [True, False])
def test_likeliest_wholes_are_the_twins(compiled: bool) -> None:
    model, group = apart(12, members=6)
    # clusters overlap, every second one a wide one
    model = model.with_(means=0.1 * model.means, log_scales=model.log_scales + (group % 2)[:, None].astype(np.float32))
    suspect = merge_groups(model, group, surface=True)
    parts, wholes = Parts.of(model), Wholes(suspect)
    near = np.tile(np.arange(len(suspect)), (len(model), 1))
    function = likeliest_wholes if compiled else likeliest_wholes.py_func
    found = owner, distance2 = np.full(len(model), -1, np.int32), np.full(len(model), np.inf)
    whole = (wholes.centers, wholes.precision, wholes.log_det, wholes.colors)
    function(parts.means, parts.sigma, parts.colors, near, *whole, found)
    for i in range(len(model)):
        best, expected = twin.likeliest_whole(
            parts.means[i],
            parts.sigma[i],
            parts.colors[i],
            wholes.centers,
            covariances(suspect),
            wholes.colors,
            color_std=CONFIG.merging.color_std,
            limit=CONFIG.merging.limit,
        )
        assert owner[i] == best
        assert distance2[i] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("moved", [False, True])
def test_parts_and_shares_of_merged_gaussians(moved: bool) -> None:
    model, group = apart(200)
    suspect = merge_groups(model, group, surface=True)
    fit = Similarity.identity()
    if moved:
        R = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
        R *= np.sign(np.linalg.det(R))
        fit = Similarity(0.4, R, np.array([1.0, 2.0, 3.0]))
        back = fit.inverse()
        suspect = transform_model(suspect, back.scale, back.R, back.t)
    mixtures = mix(Parts.of(model), suspect, fit, *nobody(200))
    order = np.argsort(mixtures.reference_rows)
    np.testing.assert_array_equal(mixtures.reference_rows[order], np.arange(600))
    np.testing.assert_array_equal(mixtures.suspect_rows[order], group)
    mass = surface_mass(model)
    np.testing.assert_allclose(mixtures.shares[order], mass / np.bincount(group, mass)[group])
    assert mixtures.quality.min() > 0.9


def test_what_was_not_merged_keeps_its_match() -> None:
    """One of each three was not merged, and lies amid the others."""
    model, group = apart(200)
    alone = np.arange(2, 600, 3)
    group[alone] = 200 + np.arange(200)
    suspect = merge_groups(model, group, surface=True)
    matches, quality = nobody(400)
    matches[200:], quality[200:] = alone, 0.7
    mixtures = mix(Parts.of(model), suspect, Similarity.identity(), matches, quality)
    for row, partner in zip(range(200, 400), alone, strict=True):
        assert mixtures.reference_rows[mixtures.suspect_rows == row].tolist() == [partner]
        assert mixtures.quality[row] == np.float32(0.7)
    assert (np.bincount(mixtures.reference_rows, minlength=600) == 1).all()
    np.testing.assert_allclose(np.bincount(mixtures.suspect_rows, mixtures.shares), 1.0)


def test_trust_falls_where_the_moments_disagree() -> None:
    """Centre, or size, of every second suspect Gaussian is another's: no mixture of what lies there."""
    model, group = apart(200)
    suspect = merge_groups(model, group, surface=True)
    means, log_scales = suspect.means.copy(), suspect.log_scales.copy()
    means[::4] += 0.06
    log_scales[2::4] += 0.6
    quality = mix(
        Parts.of(model), suspect.with_(means=means, log_scales=log_scales), Similarity.identity(), *nobody(200)
    ).quality
    assert np.median(quality[::4]) < 0.3
    assert np.median(quality[2::4]) < 0.3
    assert quality[1::2].min() > 0.9


def test_parts_that_lie_elsewhere_belong_to_nobody() -> None:
    model, group = apart(200)
    suspect = merge_groups(model, group, surface=True).take(np.arange(50))
    mixtures = mix(Parts.of(model), suspect, Similarity.identity(), *nobody(50))
    np.testing.assert_array_equal(np.sort(mixtures.reference_rows), np.arange(150))


def test_nothing_is_mixed_where_everything_is_matched() -> None:
    model, _ = apart(10)
    rows = np.arange(30, dtype=np.int32)
    mixtures = mix(Parts.of(model), model, Similarity.identity(), rows, np.ones(30, np.float32))
    np.testing.assert_array_equal(mixtures.reference_rows, rows)
    assert (mixtures.shares == 1.0).all()


def test_plain_matches_are_mixtures_of_one() -> None:
    matches = np.array([3, -1, 0, 2], np.int32)
    quality = np.array([1.0, 0.0, 0.0, 0.5], np.float32)
    mixtures = Mixtures.of_matches(matches, quality)
    assert mixtures.suspect_rows.tolist() == [0, 3]
    assert mixtures.reference_rows.tolist() == [3, 2]
    assert mixtures.explained(0.6).tolist() == [True, False, False, False]
