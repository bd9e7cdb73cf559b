"""WhitenedGrid against the all-pairs twin."""

from __future__ import annotations

import numpy as np
import pytest

from engine.numerics.nearest import REACH, WhitenedGrid
from tests.reference.nearest import distances2
from tests.threads import with_one_and_two_threads


def scene(n: int, d: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    centers = rng.normal(0, 10, (8, d))
    points = centers[rng.integers(8, size=n)] + rng.normal(0, 2, (n, d))
    quats = rng.normal(size=(n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return points.astype(np.float32), quats.astype(np.float32)


@pytest.mark.parametrize("n", [1, 7, 600])
@pytest.mark.parametrize(("quat_weight", "hard", "cap"), [(0.0, 10, 0.0), (50.0, 6, 8.0), (20.0, 10, 0.0)])
def test_against_twin(n, quat_weight, hard, cap):
    points, quats = scene(n, 10, 0)
    rng = np.random.default_rng(1)
    rows = rng.integers(n, size=300)
    queries = (points[rows] + rng.normal(0, 1, (300, 10))).astype(np.float32)
    turned = quats[rows] + rng.normal(0, 0.05, (300, 4)).astype(np.float32)
    turned /= -np.linalg.norm(turned, axis=1, keepdims=True)  # the other sign is the same rotation
    grid = WhitenedGrid(points, quats, quat_weight=quat_weight, hard=hard, soft_cap=cap)
    got = grid.query(queries, turned, box=6.0, limit2=36.0)  # box^2 = limit: the grid itself loses nothing
    for i in range(300):
        d2 = distances2(points, quats, queries[i], turned[i], quat_weight=quat_weight, hard=hard, soft_cap=cap)
        best = int(np.argmin(d2))
        if d2[best] > 36.0:
            assert got.index[i] == -1
            assert got.probability[i] == 0
            continue
        assert got.distance2[i] == pytest.approx(d2[best], rel=1e-3, abs=1e-3)
        near = d2[(d2 <= 36.0) & (d2 < d2[best] + 40)]
        exact = 1 / np.exp(-0.5 * (near - near.min())).sum()
        # what lies beyond the reach is left out
        assert got.probability[i] == pytest.approx(exact, abs=len(near) * float(np.exp(-REACH / 2)) + 1e-3)
    assert (got.index >= 0).mean() > 0.5


def test_twins_share_the_probability():
    points, quats = scene(200, 10, 3)
    double = np.concatenate([points, points])
    grid = WhitenedGrid(double, np.concatenate([quats, quats]), quat_weight=1.0, hard=10, soft_cap=0.0)
    got = grid.query(points, quats, box=3.0, limit2=9.0)
    assert got.probability.max() <= 0.5 + 1e-6
    np.testing.assert_array_equal(got.index % 200, np.arange(200))


def test_all_points_the_same():
    points = np.ones((500, 10), np.float32)
    quats = np.tile(np.float32([1, 0, 0, 0]), (500, 1))
    grid = WhitenedGrid(points, quats, quat_weight=1.0, hard=10, soft_cap=0.0)
    got = grid.query(points[:5], quats[:5], box=3.0, limit2=9.0)
    assert (got.index >= 0).all()
    assert got.probability.max() < 0.01


def test_threads_do_not_matter():
    points, quats = scene(3000, 10, 4)
    grid = WhitenedGrid(points, quats, quat_weight=5.0, hard=10, soft_cap=0.0)
    queries = points + np.float32(0.7)
    one, two = with_one_and_two_threads(lambda: grid.query(queries, quats, box=3.2, limit2=30.0))
    for name in ("index", "distance2", "probability"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
