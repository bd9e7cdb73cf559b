"""Optimal transport against known answers."""

from __future__ import annotations

import numpy as np
import pytest

from engine.lab.evaluate.null.detectability import divergence, permutation_test, squared_distances, transport_cost


@pytest.mark.parametrize("epsilon", [0.05, 0.3, 2.0])
def test_two_by_two_in_closed_form(epsilon: float) -> None:
    """Mass a stays with each point, 1/2 - a moves, a / (1/2 - a) = exp(1 / eps)."""
    cost = np.array([[0.0, 1.0], [1.0, 0.0]])
    stay = 0.5 / (1.0 + np.exp(-1.0 / epsilon))
    move = 0.5 - stay
    entropy = 2.0 * (stay * np.log(4.0 * stay) + (move * np.log(4.0 * move) if move > 0 else 0.0))
    assert transport_cost(cost, epsilon) == pytest.approx(2.0 * move + epsilon * entropy, abs=1e-6)


def test_little_entropy_gives_the_assignment_problem() -> None:
    from scipy.optimize import linear_sum_assignment

    rng = np.random.default_rng(0)
    cost = squared_distances(rng.normal(size=(12, 2)), rng.normal(size=(12, 2)) + 1.0)
    rows, columns = linear_sum_assignment(cost)
    assert transport_cost(cost, 0.01, rounds=20_000) == pytest.approx(cost[rows, columns].mean(), rel=0.02)


def test_divergence_of_a_shift_is_its_square() -> None:
    """Moved by s, a sample is |s|^2 away whatever the entropy: the debiased cost sees translations exactly."""
    rng = np.random.default_rng(1)
    a = rng.normal(size=(40, 3))
    shift = np.array([3.0, 0.0, 4.0])
    joint = np.concatenate([a, a + shift])
    assert divergence(squared_distances(joint, joint), 40, 5.0) == pytest.approx(25.0, rel=1e-2)
    same = np.concatenate([a, a])
    assert divergence(squared_distances(same, same), 40, 1.0) == pytest.approx(0.0, abs=1e-6)


def test_permutation_p_values() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(40, 2)), rng.normal(size=(40, 2))
    distance, p, null = permutation_test(a, b, draws=39)
    assert p > 0.05
    assert len(null) == 39
    far, p, _ = permutation_test(a, b + 2.0, draws=39)
    assert p == pytest.approx(1 / 40)
    assert far > distance
