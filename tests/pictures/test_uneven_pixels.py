"""Pictures that were made narrower or wider, and photographs of a screen."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from engine.model import Camera, GaussianModel
from engine.pictures.camera import camera_search, uneven_pixels
from engine.pictures.camera.camera_motion import UNEVEN, project
from engine.pictures.camera.camera_proposals import Candidate, Candidates
from engine.pictures.camera.camera_search import find_camera
from engine.pictures.camera.keypoint_cameras import MatchedKeypoints
from engine.pictures.camera.pixel_shape import SQUARE, PixelShape
from engine.pictures.camera.pose_ransac import Hypothesis, fit_camera
from engine.pictures.camera.uneven_pixels import refine_shape
from engine.pictures.landmarks.keypoints import luma
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import render
from tests.pictures.plant_views import around, jpeg, reprojection


@pytest.fixture(scope="module")
def points(plant: GaussianModel) -> np.ndarray:
    return plant.means[:: len(plant) // 200].astype(np.float64)


@pytest.mark.parametrize("shape", [PixelShape(0.75), PixelShape(1.4), PixelShape(0.9, 0.1), PixelShape(1.1, -0.2)])
def test_a_picture_taken_back_is_the_one_that_was_taken(plant: GaussianModel, shape: PixelShape) -> None:
    """The camera goes along, no pixel of the picture is lost, and the corner stays in it."""
    camera = around(plant, 48, 33, 1.1, 0.8)
    image = np.clip(render(plant, camera), 0, 1)
    shift = max(0.0, -shape.slant * 360)
    width, height = round(480 * shape.ratio + abs(shape.slant) * 360), 360
    there = np.column_stack([shape.matrix, shape.matrix @ [0.5, 0.5] - 0.5 + [shift, 0.0]])
    uneven = cv2.warpAffine(image, there, (width, height), flags=cv2.INTER_AREA)
    K = camera.K.copy()
    K[0, 2] += shift / shape.ratio  # so that the shape's origin is the picture's corner
    square = shape.squared_camera(Camera(camera.viewmat, K, 480, 360), width, height)
    back = shape.undo(uneven)
    assert back.shape[:2] == (square.height, square.width) == shape.square_size(width, height)[::-1]
    assert min(back.shape[0] - height, back.shape[1] - width * min(shape.ratio, 1)) >= -1e-6
    np.testing.assert_allclose(square.K[0, 0], square.K[1, 1])
    expected = np.clip(render(plant, square), 0, 1)
    assert np.corrcoef(luma(back).ravel(), luma(expected).ravel())[0, 1] > 0.995


def test_shapes_follow_one_another() -> None:
    first, rest = PixelShape(0.8, 0.1), PixelShape(1.05, -0.02)
    pixels = np.random.default_rng(0).random((5, 2)) * 100
    both = first.after(rest)
    np.testing.assert_allclose(both.squared(pixels), rest.squared(first.squared(pixels)))
    assert SQUARE.after(first) == first
    # The picture turned over: x becomes width - x on both sides.
    over = pixels * (-1, 1)
    np.testing.assert_allclose(first.turned_over().squared(over), first.squared(pixels) * (-1, 1))


@pytest.mark.parametrize("shape", [PixelShape(0.9, 0.05), PixelShape(1.2, -0.1)])
def test_matches_tell_the_shape_among_outliers(plant: GaussianModel, points: np.ndarray, shape: PixelShape) -> None:
    true = around(plant, 48, 33, 1.1, 0.8)
    rng = np.random.default_rng(1)
    pixels = project(points, true) @ shape.matrix.T + rng.normal(0, 0.3, (len(points), 2))
    wrong = rng.random(len(points)) < 0.3
    pixels[wrong] += rng.uniform(-60, 60, (int(wrong.sum()), 2))
    camera = around(plant, 49, 32, 1.15, 0.82)
    for tolerance in (12.0, 4.0, 1.0):
        fitted = fit_camera(points, pixels, camera, tolerance, free=UNEVEN)
        assert fitted is not None
        camera = fitted.camera
    last = fit_camera(points, pixels, camera, 1.0, free=UNEVEN, shape=fitted.shape)
    assert last is not None
    np.testing.assert_allclose([last.shape.ratio, last.shape.slant], [shape.ratio, shape.slant], atol=0.004)
    shown = project(points, last.camera) @ last.shape.matrix.T
    np.testing.assert_allclose(shown[~wrong], (project(points, true) @ shape.matrix.T)[~wrong], atol=0.3)


@pytest.mark.parametrize("shape", [PixelShape(0.3), PixelShape(3.0), PixelShape(1.0, 1.2)])
def test_a_shape_that_nobody_makes_is_none(plant: GaussianModel, shape: PixelShape) -> None:
    """A picture crafted to be taken back to a hundred times its size is left as it is."""
    camera = around(plant, 48, 33, 1.1, 0.8)
    plain = np.clip(render(plant, camera), 0, 1)
    found = Hypothesis(camera, np.ones(1, dtype=bool), 1.0, shape)
    assert refine_shape(plant, plain, found) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratio", "mirrored"),
    [pytest.param(0.65, False, marks=pytest.mark.long), pytest.param(0.93, True, marks=pytest.mark.long), (1.6, False)],
)
def test_the_camera_of_a_picture_scaled_unevenly_is_found(
    plant: GaussianModel, bank: Landmarks, ratio: float, mirrored: bool
) -> None:
    true = around(plant, 48, 33, 1.1, 0.8)
    image = cv2.resize(np.clip(render(plant, true), 0, 1), (round(480 * ratio), 360), interpolation=cv2.INTER_AREA)
    image = jpeg(image[:, ::-1] if mirrored else image, 90)
    found = find_camera(bank, plant, np.ascontiguousarray(image))
    assert found is not None
    assert found.shape is not None
    assert found.mirrored is mirrored
    assert found.shape.ratio == pytest.approx(ratio, rel=0.01)
    face = found.face(image)
    assert face.shape[:2] == (found.camera.height, found.camera.width)
    enlarged = max(found.shape.ratio, 1.0)
    width = round(480 * enlarged)
    assert abs(face.shape[1] - width) <= 0.01 * width
    shown = np.clip(render(plant, found.camera), 0, 1)
    assert np.corrcoef(luma(face).ravel(), luma(shown).ravel())[0, 1] > 0.99
    whole = found.of_whole(image)
    assert (whole.width, whole.height) == face.shape[1::-1]
    assert reprojection(plant, true.resized(whole.width, whole.height), whole) < 0.015 * width


@pytest.mark.slow
def test_the_photograph_of_a_screen_seen_from_aside_is_recognised(plant: GaussianModel, bank: Landmarks) -> None:
    image = np.clip(render(plant, around(plant, 48, 33, 1.1, 0.8)), 0, 1)
    corners = np.array([[0, 0], [480, 0], [480, 360], [0, 360]], np.float32)
    seen = np.array([[90, 70], [560, 100], [545, 425], [105, 470]], np.float32)
    there = cv2.getPerspectiveTransform(corners, seen)
    photo = cv2.warpPerspective(image, there, (640, 520), flags=cv2.INTER_AREA, borderValue=(0.35, 0.34, 0.33))
    photo = jpeg(0.9 * photo + 0.04, 85)
    found = find_camera(bank, plant, photo)
    assert found is not None
    assert found.shape is not None
    assert found.correlation > 0.97


def test_a_shape_must_explain_more_than_square_pixels_do_in_the_end(
    plant: GaussianModel, bank: Landmarks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rough look at a wide lens took a guitar's perspective for a slant, which was kept: half of its evidence."""
    kept, slanted = camera_search._best_candidate, PixelShape(1.0, 0.02)

    def rough(*asked: Any) -> Candidate | None:
        best = kept(*asked)
        return None if best is None else replace(best, correlation=0.8)

    monkeypatch.setattr(camera_search, "_best_candidate", rough)
    monkeypatch.setattr(Candidates, "shape", lambda *asked: slanted)
    found = find_camera(bank, plant, jpeg(render(plant, around(plant, 48, 33, 1.1, 0.8)), 80))
    assert found is not None
    assert found.shape is None
    assert found.correlation > 0.97


def test_beside_a_settled_camera_no_shape_far_from_square_is_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    sought: list[float] = []
    monkeypatch.setattr(uneven_pixels, "_from_ratio", lambda _, ratio, __: sought.append(ratio))
    for nearly_square in (True, False):
        assert uneven_pixels.find_shape(cast(MatchedKeypoints, None), None, (1.0,), nearly_square=nearly_square) is None
        assert bool(sought) is not nearly_square
