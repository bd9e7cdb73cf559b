"""Keypoints and their matching."""

from __future__ import annotations

import numpy as np
import pytest

from engine.pictures.landmarks.keypoints import detect_keypoints, luma, match_within, noise_level
from tests.pictures.image_cases import picture


def test_keypoints_move_with_the_picture() -> None:
    gray = luma(picture(0))
    a, b = detect_keypoints(gray[:-20, :-30], 400), detect_keypoints(gray[20:, 30:], 400)
    first, second = match_within(a.descriptors, b.descriptors, 0.8)
    shift = a.points[first] - b.points[second]
    assert len(first) > 50
    assert np.mean(np.abs(shift - [30, 20]).max(axis=1) < 0.5) > 0.9


def test_brightness_does_not_decide_what_is_found() -> None:
    gray = luma(picture(0))
    whole, dim = detect_keypoints(gray, 300), detect_keypoints(0.3 * gray, 300)
    assert len(dim) == len(whole) == 300
    distance = np.linalg.norm(whole.points[:, None] - dim.points[None], axis=2).min(axis=1)
    assert np.mean(distance < 0.5) > 0.9


def test_points_are_pixel_centres_at_half_integers() -> None:
    blob = np.zeros((65, 65), dtype=np.float32)
    y, x = np.mgrid[:65, :65] + 0.5
    blob += np.exp(-((x - 32.5) ** 2 + (y - 20.5) ** 2) / 50)
    found = detect_keypoints(blob, 10)
    assert np.linalg.norm(found.points - [32.5, 20.5], axis=1).min() < 0.15


def test_descriptors_have_the_length_matching_relies_on() -> None:
    found = detect_keypoints(luma(picture(0)), 200)
    length = np.linalg.norm(found.descriptors.astype(np.float64), axis=1)
    assert np.abs(length - 512).max() < 25
    assert found.descriptors.dtype == np.uint8


def test_matching_is_lowes_test_by_definition() -> None:
    rng = np.random.default_rng(0)
    target = rng.integers(0, 60, (40, 128)).astype(np.uint8)
    query = np.clip(target[rng.integers(0, 40, 25)].astype(int) + rng.integers(-9, 10, (25, 128)), 0, 255)
    near, far = match_within(query.astype(np.uint8), target, 0.7)
    distance = np.linalg.norm(query[:, None] - target[None].astype(float), axis=2)
    order = np.sort(distance, axis=1)
    passing = order[:, 0] < 0.7 * order[:, 1]
    best: dict[int, int] = {}
    for q in np.nonzero(passing)[0]:
        t = int(distance[q].argmin())
        if t not in best or distance[q, t] < distance[best[t], t]:
            best[t] = int(q)
    assert sorted(zip(near.tolist(), far.tolist(), strict=True)) == sorted((q, t) for t, q in best.items())
    assert len(match_within(query[:0].astype(np.uint8), target, 0.7)[0]) == 0
    assert len(match_within(query.astype(np.uint8), target[:1], 0.7)[0]) == 0


def test_noise_level() -> None:
    flat = np.full((128, 128), 0.5) + np.random.default_rng(0).normal(0, 0.07, (128, 128))
    assert noise_level(flat.astype(np.float32)) == pytest.approx(0.07, rel=0.05)
    assert noise_level(np.zeros((1, 5), dtype=np.float32)) == 0.0


def test_a_flat_picture_has_no_keypoints() -> None:
    assert len(detect_keypoints(np.full((64, 64), 0.5, dtype=np.float32), 100)) == 0


def test_keypoints_turned_over_are_those_of_the_picture_turned_over() -> None:
    gray = luma(picture(0))[:, :280]
    there = detect_keypoints(gray, 400).turned_over(280)
    here = detect_keypoints(np.ascontiguousarray(gray[:, ::-1]), 400)
    first, second = match_within(there.descriptors, here.descriptors, 0.8)
    assert len(first) > 150
    assert np.mean(np.abs(there.points[first] - here.points[second]).max(axis=1) < 0.5) > 0.95
    gap = there.descriptors[first].astype(np.float64) - here.descriptors[second]
    assert np.median(np.linalg.norm(gap, axis=1)) < 40  # of 512
    again = there.turned_over(280)
    assert again.descriptors.tobytes() == detect_keypoints(gray, 400).descriptors.tobytes()
