"""The tree's answers against every distance there is."""

from __future__ import annotations

import numpy as np
import pytest

from engine.numerics.kd_tree import KdTree


def every_distance(points: np.ndarray, queries: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """What `nearest` promises, by looking at all; squares are added up in the order of the coordinates."""
    squares = np.zeros((len(queries), len(points)))
    for d in range(points.shape[1]):
        squares += np.square(points[None, :, d] - queries[:, None, d])
    order = np.argsort(squares, axis=1, kind="stable")[:, :count]
    missing = max(0, count - len(points))
    distance = np.sqrt(np.take_along_axis(squares, order, axis=1))
    return (
        np.pad(distance, ((0, 0), (0, missing)), constant_values=np.inf),
        np.pad(order, ((0, 0), (0, missing)), constant_values=len(points)),
    )


@pytest.mark.parametrize("points", [1, 2, 15, 16, 17, 33, 700, 3000])
@pytest.mark.parametrize(("dims", "count"), [(1, 2), (3, 16), (9, 2)])
def test_they_are_the_nearest_of_all(points: int, dims: int, count: int) -> None:
    rng = np.random.default_rng(points)
    there, samples = rng.normal(size=(points, dims)), 1.5 * rng.normal(size=(80, dims))
    distance, index = KdTree(there).nearest(samples, count)
    wanted, who = every_distance(there, samples, count)
    np.testing.assert_allclose(distance, wanted, rtol=1e-12)
    np.testing.assert_array_equal(index, who)


def test_of_equally_near_ones_the_first_comes_first() -> None:
    there = np.repeat(np.arange(6.0), 50)[:, None] * np.ones(3)
    index = KdTree(there).nearest(there[::50] + 0.1, 3)[1]
    np.testing.assert_array_equal(index, 50 * np.arange(6)[:, None] + np.arange(3))


def test_points_may_come_in_any_layout_and_are_left_alone() -> None:
    there = np.asfortranarray(np.random.default_rng(0).normal(size=(400, 4)))
    before = there.copy()
    tree = KdTree(there)
    assert len(tree) == 400
    np.testing.assert_array_equal(tree.nearest(there[::-1], 1)[1][:, 0], np.arange(400)[::-1])
    np.testing.assert_array_equal(there, before)
