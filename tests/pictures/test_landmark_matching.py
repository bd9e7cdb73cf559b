from __future__ import annotations

import numpy as np
import pytest

from engine.model import look_at
from engine.pictures.landmarks.keypoints import Keypoints
from engine.pictures.landmarks.landmark_matching import _nearest_look, _rank, match_landmarks, match_projected
from engine.pictures.landmarks.landmark_set import Landmarks
from tests.reference import landmark_matching as slow


def words(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 128) random descriptors of length 512."""
    raw = np.abs(rng.normal(size=(count, 128)))
    return np.round(512.0 * raw / np.linalg.norm(raw, axis=1, keepdims=True)).astype(np.uint8)


def bank(rng: np.random.Generator, views: int, per_view: int) -> Landmarks:
    count = views * per_view
    return Landmarks(
        rng.uniform(-1, 1, (count, 3)).astype(np.float32),
        words(rng, count),
        np.repeat(np.arange(views, dtype=np.int32), per_view),
    )


@pytest.mark.parametrize("compiled", [True, False])
def test_rank_agrees_with_the_twin(compiled: bool) -> None:
    rng = np.random.default_rng(0)
    landmarks, query = bank(rng, 3, 20), words(rng, 7)
    target = landmarks.descriptors.astype(np.float32)
    squares = np.einsum("ij,ij->i", target, target)
    best, first, rival = np.empty(7, np.int64), np.empty(7, np.float32), np.empty(7, np.float32)
    in_view = np.empty((7, 3, 3))
    starts = np.array([0, 20, 40, 60])
    (_rank if compiled else _rank.py_func)(
        query.astype(np.float32) @ target.T,
        squares,
        landmarks.points,
        starts,
        np.float32(0.8),
        best,
        first,
        rival,
        in_view,
    )
    own = (query.astype(np.int64) ** 2).sum(axis=1)
    for k in range(7):
        expected = slow.rank(query[k], landmarks.descriptors, landmarks.points, 0.8)
        assert (best[k], first[k] + own[k], rival[k] + own[k]) == expected
        for v in range(3):
            part = slice(starts[v], starts[v + 1])
            square = ((landmarks.descriptors[part].astype(int) - query[k].astype(int)) ** 2).sum(axis=1)
            assert in_view[k, v, 0] == starts[v] + np.argmin(square)
            assert tuple(in_view[k, v, 1:] + own[k]) == tuple(np.sort(square)[:2])


@pytest.mark.parametrize("compiled", [True, False])
def test_nearest_look_agrees_with_the_twin(compiled: bool) -> None:
    rng = np.random.default_rng(1)
    pixels, places = rng.uniform(0, 100, (9, 2)), rng.uniform(0, 100, (40, 2))
    query, target = words(rng, 9), words(rng, 40)
    best, distance = np.empty(9, np.int64), np.empty(9, np.int64)
    order = np.argsort(places[:, 1], kind="stable")
    kernel = _nearest_look if compiled else _nearest_look.py_func
    kernel(pixels, query, places, places[order, 1], order, target, 12.0, best, distance)
    for k in range(9):
        assert (best[k], distance[k]) == slow.nearest_look(pixels[k], query[k], places, target, 12.0)
    assert (best == -1).any()
    assert (best >= 0).any()


def test_copies_of_a_place_in_other_views_are_no_rivals() -> None:
    rng = np.random.default_rng(2)
    one = bank(rng, 1, 50)
    twice = Landmarks(
        np.concatenate([one.points, one.points]),
        np.concatenate([one.descriptors, one.descriptors]),
        np.repeat(np.arange(2, dtype=np.int32), 50),
    )
    keypoints = Keypoints(np.zeros((50, 2)), one.descriptors)
    sparse, dense = match_landmarks(keypoints, twice, (0.8, 0.8), 0.01, 2)
    np.testing.assert_array_equal(sparse[0], np.arange(50))
    np.testing.assert_array_equal(sparse[1] % 50, np.arange(50))
    assert len(dense[0]) == 100  # each view by itself
    apart = Landmarks(np.concatenate([one.points, one.points + 5]), twice.descriptors, twice.views)
    sparse, dense = match_landmarks(keypoints, apart, (0.8, 0.8), 0.01, 2)
    assert len(sparse[0]) == 0  # two places that look the same
    assert len(dense[0]) == 100


def test_order_of_the_bank_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    landmarks = bank(rng, 4, 30)
    keypoints = Keypoints(np.zeros((300, 2)), np.concatenate([landmarks.descriptors[::2], words(rng, 240)]))
    shuffle = rng.permutation(len(landmarks))
    shuffled = Landmarks(landmarks.points[shuffle], landmarks.descriptors[shuffle], landmarks.views[shuffle])
    for (a, b), (c, d) in zip(
        match_landmarks(keypoints, landmarks, (0.8, 0.8), 0.1, 3),
        match_landmarks(keypoints, shuffled, (0.8, 0.8), 0.1, 3),
        strict=True,
    ):
        assert len(a) >= 30
        assert set(zip(a, b, strict=True)) == set(zip(c, shuffle[d], strict=True))


def test_nothing_matches_nothing() -> None:
    rng = np.random.default_rng(4)
    none = Keypoints(np.zeros((0, 2)), np.zeros((0, 128), np.uint8))
    for a, b in match_landmarks(none, bank(rng, 1, 9), (0.8, 0.8), 0.1, 3):
        assert len(a) == len(b) == 0


def test_projected_landmarks_match_what_lies_there() -> None:
    rng = np.random.default_rng(5)
    landmarks = bank(rng, 2, 40)
    camera = look_at((0.0, 0.0, -5.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 100.0, 100, 100)
    pixels = 100.0 * landmarks.points[:, :2] / (landmarks.points[:, 2:] + 5.0)
    pixels = np.stack([50.0 + pixels[:, 0], 50.0 + pixels[:, 1]], axis=1).astype(np.float64)
    near = Keypoints(pixels + 1.0, landmarks.descriptors)
    keypoint, landmark = match_projected(near, landmarks, camera, 3.0)
    np.testing.assert_array_equal(keypoint, np.arange(80))
    np.testing.assert_array_equal(landmark, np.arange(80))
    far = Keypoints(pixels + 500.0, landmarks.descriptors)
    assert len(match_projected(far, landmarks, camera, 3.0)[0]) == 0
    unlike = Keypoints(pixels, 255 - landmarks.descriptors)
    assert len(match_projected(unlike, landmarks, camera, 3.0)[0]) == 0
