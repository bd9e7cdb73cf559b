"""A picture that was turned, zoomed or cut is that of another camera: the view is carried to it."""

from __future__ import annotations

import numpy as np
import pytest

from engine.model import Camera, look_at
from engine.numerics.resampling import map_points
from engine.pictures.alignment.planar import align_upright, near_motions
from engine.pictures.camera.camera_motion import carried, project
from tests.pictures.image_cases import picture


@pytest.fixture
def camera() -> Camera:
    return look_at((1.0, 2.0, -4.0), (0.1, 0.0, 0.2), (0.0, -1.0, 0.1), 300.0, 320, 240)


def similarity(scale: float, degrees: float, x: float, y: float) -> np.ndarray:
    a, b = scale * np.cos(np.radians(degrees)), scale * np.sin(np.radians(degrees))
    return np.array([[a, -b, x], [b, a, y], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("motion", [(1.0, 0.0, -37.0, -61.0), (0.75, 0.0, 0.0, 0.0), (1.3, 30.0, 20.0, -50.0)])
def test_points_appear_where_the_picture_was_moved_to(camera: Camera, motion: tuple[float, ...]) -> None:
    points = np.random.default_rng(0).normal(0.0, 0.5, (50, 3))
    there = carried(camera, similarity(*motion), 200, 100)
    assert there is not None
    assert (there.width, there.height) == (200, 100)
    expected = map_points(similarity(*motion), project(points, camera))
    np.testing.assert_allclose(project(points, there), expected, atol=1e-9)


@pytest.mark.parametrize("slant", [0.0, 0.01])
def test_a_view_from_aside_is_a_camera(camera: Camera, slant: float) -> None:
    turn = np.array([[0.995, slant, 0.0998], [0.0, 1.0, 0.0], [-0.0998, 0.0, 0.995]])
    aside = camera.K @ turn @ np.linalg.inv(camera.K)
    points = np.random.default_rng(0).normal(0.0, 0.5, (50, 3))
    there = carried(camera, aside / aside[2, 2], 320, 240)
    assert there is not None
    np.testing.assert_allclose(project(points, there), map_points(aside, project(points, camera)), atol=1e-6)


def test_what_no_camera_shows_is_not_carried(camera: Camera) -> None:
    assert carried(camera, np.diag([-1.0, 1.0, 1.0]), 320, 240) is None


def test_simpler_motions_are_near_a_bent_one() -> None:
    bent = np.array([[0.99839, -0.00026, -60.58], [-0.00101, 0.99874, -36.46], [-1e-6, -1e-6, 1.0]])
    whole, upright = near_motions(bent, (800, 800))
    np.testing.assert_array_equal(whole, [[1, 0, -61], [0, 1, -37], [0, 0, 1]])
    assert upright[0, 0] == upright[1, 1]
    assert upright[0, 1] == -upright[1, 0]
    assert len(near_motions(similarity(0.75, 0.0, 0.0, 0.0), (800, 800))) == 1
    true = similarity(0.9, 12.0, 4.0, 5.0)
    np.testing.assert_allclose(near_motions(true, (300, 400))[0], true, atol=1e-9)


def test_a_picture_is_laid_as_it_is_and_its_motion_told() -> None:
    plain = picture(0)
    moved = np.roll(plain, 1, axis=1)
    found = align_upright(plain, moved)
    assert found is not None
    matrix, alignment = found
    assert matrix[0, 2] == pytest.approx(1.0, abs=0.05)
    assert alignment.still
    np.testing.assert_array_equal(alignment.warped, moved)
    assert align_upright(picture(0), picture(1)) is None
