"""Pictures that were made narrower or wider, photographs of a screen, and pictures of a model that was stretched."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from engine.lab.sim.physics.deforming import deform_model
from engine.model import Camera, GaussianModel, look_at
from engine.pictures.camera import camera_proposals, camera_search, uneven_pixels
from engine.pictures.camera.camera_motion import PARAMETERS, project
from engine.pictures.camera.camera_proposals import Candidate, Candidates
from engine.pictures.camera.camera_search import find_camera
from engine.pictures.camera.camera_trial import Picture
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.keypoint_cameras import MatchedKeypoints
from engine.pictures.camera.pose_ransac import Hypothesis, fit_camera
from engine.pictures.camera.pose_refinement import refine_level
from engine.pictures.camera.uneven_pixels import is_square
from engine.pictures.landmarks.keypoints import luma
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import render
from tests.pictures.plant_views import around, jpeg, reprojection


def uneven(camera: Camera, ratio: float, skew: float = 0.0) -> Camera:
    """The camera of a picture made wider, and slanted about its first row."""
    there = np.array([[ratio, skew, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return Camera(camera.viewmat, there @ camera.K, round(ratio * camera.width), camera.height)


@pytest.mark.parametrize(("ratio", "skew"), [(0.9, 0.05), (1.2, -0.1)])
def test_matches_tell_the_shape_among_outliers(plant: GaussianModel, ratio: float, skew: float) -> None:
    points = plant.means[:: len(plant) // 200].astype(np.float64)
    true = uneven(around(plant, 48, 33, 1.1, 0.8), ratio, skew)
    rng = np.random.default_rng(1)
    pixels = project(points, true) + rng.normal(0, 0.3, (len(points), 2))
    wrong = rng.random(len(points)) < 0.3
    pixels[wrong] += rng.uniform(-60, 60, (int(wrong.sum()), 2))
    camera = around(plant, 49, 32, 1.15, 0.82)
    for tolerance in (12.0, 4.0, 1.0, 1.0):
        fitted = fit_camera(points, pixels, camera, tolerance, free=PARAMETERS)
        assert fitted is not None
        camera = fitted.camera
    np.testing.assert_allclose(camera.K[0, :2] / camera.K[1, 1], [ratio, skew], atol=0.004)
    np.testing.assert_allclose(project(points, camera)[~wrong], project(points, true)[~wrong], atol=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratio", "mirrored"),
    [pytest.param(0.65, False, marks=pytest.mark.long), pytest.param(0.93, True, marks=pytest.mark.long), (1.6, False)],
)
def test_the_camera_of_a_picture_scaled_unevenly_is_found(
    plant: GaussianModel, bank: Landmarks, ratio: float, mirrored: bool
) -> None:
    plain = around(plant, 48, 33, 1.1, 0.8)
    true = uneven(plain, ratio)
    image = cv2.resize(np.clip(render(plant, plain), 0, 1), (true.width, 360), interpolation=cv2.INTER_AREA)
    image = jpeg(image[:, ::-1] if mirrored else image, 90)
    found = find_camera(bank, plant, np.ascontiguousarray(image))
    assert found is not None
    assert found.mirrored is mirrored
    assert found.camera.K[0, 0] / found.camera.K[1, 1] == pytest.approx(ratio, rel=0.01)
    shown = np.clip(render(plant, found.camera), 0, 1)
    assert np.corrcoef(luma(found.face(image)).ravel(), luma(shown).ravel())[0, 1] > 0.99
    assert reprojection(plant, true, found.of_whole(image)) < 0.015 * true.width


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
    assert abs(found.camera.K[0, 1] / found.camera.K[1, 1]) > 0.02
    assert found.correlation > 0.97


def stretched_upwards(model: GaussianModel, factor: float) -> GaussianModel:
    A = np.diag([1.0, factor, 1.0])
    return deform_model(model, model.means @ A.T, A[None], np.zeros(len(model), np.int32))


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.1, pytest.param(1.2, marks=pytest.mark.long)])
def test_a_stretched_model_is_seen_by_a_camera_of_the_original(
    plant: GaussianModel, bank: Landmarks, factor: float
) -> None:
    """K R A is again a K' R': from obliquely above that moves the principal point, and makes pixels uneven."""
    true, stretched = around(plant, 48, 33, 1.1, 0.8), stretched_upwards(plant, factor)
    picture = jpeg(render(stretched, true), 90)
    first = next(Candidates(Picture(plant, picture), bank, CONFIG.focals, CONFIG.other_focals).by_keypoints(False))
    assert not is_square(first.camera)
    found = find_camera(bank, plant, picture)
    assert found is not None
    pixels = project(stretched.means[::50].astype(np.float64), true)
    seen = (np.abs(pixels - (240.0, 180.0)) < (240.0, 180.0)).all(axis=1)
    off = np.linalg.norm(project(plant.means[::50].astype(np.float64), found.camera) - pixels, axis=1)[seen]
    assert np.sqrt(np.mean(off**2)) < 0.5


def test_before_something_flat_the_fit_does_not_run_away() -> None:
    """Of eleven numbers a view of a plane tells eight: undamped, three of them ended it after two renders."""
    rng = np.random.default_rng(0)
    means = np.column_stack([rng.uniform(-1.0, 1.0, 3000), rng.uniform(-0.5, 0.5, 3000), np.zeros(3000)])
    gray = rng.normal(0.0, 0.9, (3000, 1, 1)) * np.ones(3)
    sizes, quats, logits = rng.normal(-3.6, 0.4, (3000, 3)), rng.normal(size=(3000, 4)), rng.normal(2.0, 1.0, 3000)
    panel = GaussianModel(means, sizes, quats, logits, gray)
    camera = look_at((0.3, -0.5, -2.5), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 440.0, 400, 300)
    picture = luma(jpeg(render(stretched_upwards(panel, 1.1), camera), 80))
    found = refine_level(panel, picture, camera, 20, 0.005, free=PARAMETERS, max_error=3.0)
    assert found is not None
    assert found.correlation > 0.99


@pytest.mark.parametrize(("ratio", "correlation", "enough"), [(1.0, 0.93, True), (0.9, 0.93, False), (0.9, 0.97, True)])
def test_pixels_that_are_not_square_must_explain_more(
    plant: GaussianModel, ratio: float, correlation: float, enough: bool
) -> None:
    """Of a guitar in a picture made narrower, a camera of four times the focal length explained 0.94 and ended it."""
    camera = uneven(around(plant, 48, 33, 1.1, 0.8), ratio)
    candidate = Candidate(camera, False, 60, correlation=correlation, uncovered_correlation=0.97)
    assert candidate.settled is enough
    assert camera_search._explained(candidate) is enough


@pytest.mark.slow
def test_a_slant_that_keypoints_make_up_is_taken_back(
    plant: GaussianModel, bank: Landmarks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rough look at a wide lens took a guitar's perspective for a slant, which was kept: half of its evidence."""
    kept, true = camera_search._best_candidate, around(plant, 48, 33, 1.1, 0.8)

    def rough(*asked: Any) -> Candidate | None:
        best = kept(*asked)
        return None if best is None else replace(best, correlation=0.8)

    monkeypatch.setattr(camera_search, "_best_candidate", rough)
    monkeypatch.setattr(Candidates, "uneven", lambda *_: Candidate(uneven(true, 1.0, 0.02), False, 60))
    found = find_camera(bank, plant, jpeg(render(plant, true), 80))
    assert found is not None
    assert abs(found.camera.K[0, 1]) < 0.003 * found.camera.K[1, 1]
    assert reprojection(plant, true, found.camera) < 0.2


@pytest.mark.parametrize(("skew", "kept"), [(0.004, False), (-0.05, True)])
def test_pixels_that_are_square_after_all_are_no_others(
    plant: GaussianModel, monkeypatch: pytest.MonkeyPatch, skew: float, kept: bool
) -> None:
    camera = uneven(around(plant, 48, 33, 1.1, 0.8), 1.0, skew)
    found = Hypothesis(camera, np.ones(1, dtype=bool), 1.0)
    monkeypatch.setattr(camera_proposals, "find_uneven", lambda *_, **__: found)
    none = Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.int32))
    candidates = Candidates(Picture(plant, np.clip(render(plant, camera), 0, 1)), none, (), ())
    assert (candidates.uneven(None, False) is not None) is kept


def test_beside_a_settled_camera_no_shape_far_from_square_is_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    sought: list[float] = []
    monkeypatch.setattr(uneven_pixels, "_from_ratio", lambda _, ratio, __: sought.append(ratio))
    for nearly_square in (True, False):
        nothing = cast(MatchedKeypoints, None)
        assert uneven_pixels.find_uneven(nothing, None, (1.0,), nearly_square=nearly_square) is None
        assert bool(sought) is not nearly_square
