"""What suspect Gaussians that speak for several code vectors say about each."""

from __future__ import annotations

import numpy as np
import pytest

from engine.watermark.code_shares import CodeShares


def shares(matrix: np.ndarray) -> CodeShares:
    rows, codes = np.nonzero(matrix)
    return CodeShares(rows, codes.astype(np.int32), matrix[rows, codes], matrix.shape)


def test_of_single_shares_it_is_the_weighted_mean() -> None:
    rng = np.random.default_rng(0)
    label, trust, values = rng.integers(0, 5, 80), rng.uniform(0.1, 1.0, 80), rng.standard_normal((80, 3))
    each = CodeShares(np.arange(80), label.astype(np.int32), np.ones(80), (80, 5))
    means = each.means(values, trust)
    for code in range(5):
        mine = label == code
        np.testing.assert_allclose(means[code], np.average(values[mine], axis=0, weights=trust[mine]))
    np.testing.assert_allclose(each.explained(means, values, trust), means[label])


def test_parts_of_one_code_vector_add_up() -> None:
    each = CodeShares(np.array([0, 0, 1]), np.array([2, 2, 0], np.int32), np.array([0.25, 0.75, 1.0]), (2, 3))
    rows, codes, shares = each.entries
    assert (rows.tolist(), codes.tolist()) == ([0, 1], [2, 0])
    np.testing.assert_allclose(shares, [1.0, 1.0])


def test_residuals_go_back_by_their_shares() -> None:
    """Least squares for one code vector at a time: sum t s e / sum t s^2."""
    matrix = np.array([[0.5, 0.5], [0.2, 0.8], [0.0, 1.0]])
    trust, values = np.array([1.0, 0.5, 0.25]), np.array([[1.0, 0, 2], [3.0, 1, 0], [-1.0, 4, 0]])
    means = shares(matrix).means(values, trust)
    for code in range(2):
        s = matrix[:, code]
        np.testing.assert_allclose(means[code], (trust * s) @ values / (trust @ s**2))


def test_what_is_explained_goes_by_shares() -> None:
    matrix = np.array([[0.5, 0.5, 0.0], [0.2, 0.3, 0.5], [0.0, 1.0, 0.0]])
    means, trust = np.array([[1.0, 0, 2], [3.0, 1, 0], [-1.0, 4, 0]]), np.array([1.0, 0.5, 0.25])
    shown = matrix @ means
    np.testing.assert_allclose(shares(matrix).explained(means, 2.0 * shown, trust), shown)
    np.testing.assert_allclose(shares(matrix).explained(means, 0.25 * shown, trust), 0.25 * shown)


def test_displacements_come_back_signed_from_mixtures() -> None:
    """Three parts of random code vectors each: nine signs in ten are right though each speaks for three."""
    rng = np.random.default_rng(1)
    matrix = np.zeros((3000, 200))
    for part in range(3):
        matrix[np.arange(3000), rng.integers(0, 200, 3000)] += (0.6, 0.3, 0.1)[part]
    truth = rng.choice([-1.0, 1.0], (200, 3))
    means = shares(matrix).means(matrix @ truth, np.ones(3000))
    assert np.mean(np.sign(means) == truth) > 0.9


def test_together_they_explain_no_more_than_there_is() -> None:
    """Eight code vectors in each of many Gaussians: each is given all of the residual, all together once."""
    rng = np.random.default_rng(2)
    matrix = np.full((500, 8), 1 / 8)
    values, trust = rng.standard_normal((500, 3)) + 1.0, np.ones(500)
    each = shares(matrix)
    left = values - each.explained(each.means(values, trust), values, trust)
    np.testing.assert_allclose(left.mean(axis=0), 0.0, atol=0.2)
    assert np.square(left).sum() < np.square(values).sum()


def test_variance_is_that_of_the_mean() -> None:
    """Of many draws of noise, for a code vector with many members; unseen ones have none."""
    rng = np.random.default_rng(3)
    matrix = np.concatenate([np.full((400, 1), 0.5), np.zeros((400, 1))], axis=1)
    trust = rng.uniform(0.2, 1.0, 400)
    each = shares(matrix)
    noise = rng.standard_normal((300, 400, 3))
    measured = np.var([each.means(draw, trust)[0, 0] for draw in noise])
    predicted = each.variance(noise[0], trust)
    assert predicted[0, 0] == pytest.approx(measured, rel=0.35)
    assert np.isinf(predicted[1]).all()


def test_spread_of_few_members_is_blended_with_all() -> None:
    """One member that errs by nothing is no witness of certainty."""
    label = np.concatenate([np.zeros(200), [1]]).astype(np.int32)
    each = CodeShares(np.arange(201), label, np.ones(201), (201, 2))
    left = np.concatenate([np.random.default_rng(4).standard_normal((200, 1)), [[0.0]]])
    assert each.variance(left, np.ones(201))[1, 0] > 0.5
