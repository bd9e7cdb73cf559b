"""The kernels of the hypotheses against their slow twins."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.registration.config import Agreement
from engine.registration.match_kernels import BINS, Pairs, degrees_of_agreement, evidence
from tests.reference import agreement


def pairs(n: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Half of them moved by one similarity and a little noise, half of them anywhere."""
    rng = np.random.default_rng(3)
    R, x = Rotation.random(rng=1), rng.normal(size=(n, 3))
    y, size, turn = 2.0 * R.apply(x) + 1.0, np.full(n, math.log(2.0)), np.tile(R.as_quat()[[3, 0, 1, 2]], (n, 1))
    y += rng.normal(scale=np.geomspace(1e-4, 0.1, n)[:, None], size=(n, 3))
    size += rng.normal(scale=0.05, size=n)
    wrong = np.arange(n) % 2 == 0
    y[wrong], size[wrong] = rng.normal(size=(wrong.sum(), 3)), rng.normal(size=wrong.sum())
    turn[wrong] = np.roll(Rotation.random(wrong.sum(), rng=2).as_quat(), 1, axis=1)
    return x, y, size, turn, R.as_matrix(), np.array([2.0, 1.0, 1.0, 1.0])


@pytest.mark.parametrize("tolerance", [0.02, 0.1, 5.0])
def test_evidence_is_that_of_the_slow_twin(tolerance: float) -> None:
    x, y, size, turn, R, moved = pairs()
    chance = np.maximum(2.0 ** (-1.5 * np.arange(BINS)), 1e-7)
    wanted = agreement.evidence(x, y, size, R, moved, tolerance, 1.5, chance)
    found = evidence(Pairs(x, y, size, turn), R, moved, tolerance, 1.5, chance)
    assert found[1] == wanted[1]
    assert found[0] == pytest.approx(wanted[0], rel=1e-12)
    assert wanted[0] > 5.0


@pytest.mark.parametrize("angle", [0.12, 0.6, math.inf])
def test_who_agrees_is_that_of_the_slow_twin(angle: float) -> None:
    x, y, size, turn, *_ = pairs()
    found = degrees_of_agreement(Pairs(x, y, size, turn), Agreement(0.2, 0.15, angle))
    np.testing.assert_array_equal(found, agreement.degrees(x, y, size, turn, 0.2, 0.15, angle))
    assert found.max() > 10
