from __future__ import annotations

import numpy as np
import pytest

from engine.model import Float64, Int64
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.voted_views import MOST, _neighbors, agreement_of_views
from tests.reference.view_agreement import agreement_slowly


def votes(seed: int, count: int) -> tuple[Int64, Float64, Float64, Float64]:
    """Votes for five views, those for view 7 by one similarity with a few pixels of error."""
    rng = np.random.default_rng(seed)
    view = rng.choice([2, 3, 7, 11, 900], count).astype(np.int64)
    spots, places = rng.uniform(0, 900, (count, 2)), rng.uniform(0, 640, (count, 2))
    turned = (spots @ (1, 1j)) * 0.6 * np.exp(2j) + (300 + 200j) + rng.normal(0, 3, count)
    mine = view == 7
    places[mine] = np.stack([turned.real, turned.imag], axis=1)[mine]
    spots[::9] = spots[0]  # keypoints of several directions at one spot
    return view, spots, places, rng.random(count)


@pytest.mark.parametrize(("seed", "count"), [(0, 2), (1, 30), (2, 120), (3, 500)])
def test_the_kernel_says_what_the_slow_twin_says(seed: int, count: int) -> None:
    told, slowly = agreement_of_views(*votes(seed, count)), agreement_slowly(*votes(seed, count))
    np.testing.assert_array_equal(told[0], slowly[0])
    np.testing.assert_allclose(told[1], slowly[1], rtol=1e-9)


def test_what_lies_as_it_lay_is_louder_than_what_does_not() -> None:
    view, spots, places, gain = votes(4, 200)
    names, best, maps = agreement_of_views(view, spots, places, gain)
    assert names[np.argmax(best)] == 7
    a, b, c, d = maps[np.argmax(best)]
    assert abs(complex(a, b) - 0.6 * np.exp(2j)) < 0.003  # of all that agree, not of the two that began
    assert abs(complex(c, d) - (300 + 200j)) < 2
    assert best.max() > 3 * np.sort(best)[-2]


def test_many_keypoints_on_one_place_count_once() -> None:
    rng = np.random.default_rng(0)
    spots = np.concatenate([[[0.0, 0.0]], 300 + rng.uniform(0, 20, (40, 2))])
    places = np.concatenate([[[0.0, 0.0]], np.full((40, 2), 301.0)])
    _, best, _ = agreement_of_views(np.zeros(41, np.int64), spots, places, np.ones(41))
    assert best[0] == 2.0


def test_only_so_many_votes_of_a_view_are_looked_at() -> None:
    rng = np.random.default_rng(1)
    spots = rng.permutation(
        np.stack(np.meshgrid(np.arange(0, 300, 10.0), np.arange(0, 300, 10.0)), axis=2).reshape(-1, 2)
    )
    _, best, _ = agreement_of_views(np.zeros(len(spots), np.int64), spots, spots, np.ones(len(spots)))
    assert best[0] == MOST


def test_votes_are_for_the_nearest_landmarks() -> None:
    rng = np.random.default_rng(5)
    queries, targets = (rng.integers(0, 256, (count, 128), dtype=np.uint8) for count in (300, 40))
    targets[30:35] = targets[7]  # as near: the first comes first
    away = np.linalg.norm(queries[:, None].astype(np.float64) - targets, axis=2)
    order = np.argsort(away, axis=1, kind="stable")[:, : CONFIG.votes.nearest + 1]
    near, gain = _neighbors(queries, targets)
    np.testing.assert_array_equal(near.reshape(300, -1), order[:, :-1])
    away = np.take_along_axis(away, order, axis=1)
    np.testing.assert_allclose(gain.reshape(300, -1), 1.0 - away[:, :-1] / away[:, -1:], atol=1e-12)
