"""Similarity fits: exact on exact pairs, robust to wrong ones, silent where nothing is determined."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.numerics.umeyama import Similarity, robust_umeyama, umeyama

TRUTH = Similarity(0.37, Rotation.random(random_state=4).as_matrix(), np.array([5.0, -3.0, 2.0]))


def angle(a: Similarity, b: Similarity) -> float:
    return float(np.linalg.norm(a.R - b.R))


@pytest.mark.parametrize("n", [3, 4, 500])
def test_exact_pairs(n):
    x = np.random.default_rng(0).normal(size=(n, 3))
    fit = umeyama(x, TRUTH.apply(x))
    assert fit is not None
    assert fit.scale == pytest.approx(0.37)
    assert angle(fit, TRUTH) < 1e-9
    np.testing.assert_allclose(fit.t, TRUTH.t, atol=1e-9)


def test_a_mirror_image_is_answered_by_a_proper_rotation():
    x = np.random.default_rng(0).normal(size=(50, 3))
    fit = umeyama(x, x * [1, 1, -1])
    assert fit is not None
    assert np.linalg.det(fit.R) == pytest.approx(1)


def test_weights_count():
    rng = np.random.default_rng(1)
    x = rng.normal(size=(40, 3))
    y = TRUTH.apply(x)
    y[:10] += 5
    fit = umeyama(x, y, np.r_[np.zeros(10), np.ones(30)])
    assert fit is not None
    assert angle(fit, TRUTH) < 1e-9


def test_a_third_of_wrong_pairs_does_no_harm():
    rng = np.random.default_rng(2)
    x = rng.normal(size=(300, 3))
    y = TRUTH.apply(x)
    y[:100] = rng.normal(size=(100, 3)) * 3
    plain, fit = umeyama(x, y), robust_umeyama(x, y, rounds=40)
    assert plain is not None
    assert fit is not None
    assert angle(fit, TRUTH) < 1e-6 < angle(plain, TRUTH)


@pytest.mark.parametrize("x", [np.zeros((2, 3)), np.zeros((10, 3)), np.outer(np.arange(10.0), [1, 2, 3])])
def test_undetermined(x):
    assert umeyama(x, TRUTH.apply(x)) is None
    assert robust_umeyama(x, TRUTH.apply(x)) is None


def test_inverse():
    x = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(TRUTH.inverse().apply(TRUTH.apply(x)), x, atol=1e-12)
    np.testing.assert_array_equal(Similarity.identity().apply(x), x)
