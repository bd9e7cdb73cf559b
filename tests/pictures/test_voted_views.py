from __future__ import annotations

import numpy as np
import pytest

from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.model import Camera, Float64, look_at
from engine.pictures.camera import keypoint_cameras
from engine.pictures.camera.camera_motion import moved, project, swung
from engine.pictures.camera.camera_search import find_camera
from engine.pictures.camera.pose_ransac import Hypothesis
from engine.pictures.camera.voted_views import vote_for_views
from engine.pictures.landmarks.keypoints import Keypoints
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from engine.raster import render
from tests.pictures.rolling import rolled
from tests.registration.registration_cases import scene as clusters
from tests.scenes import PLANT

SIZE = (900, 700)
VIEWS = 6


def bank(rng: np.random.Generator) -> tuple[Landmarks, list[Camera]]:
    """Two hundred places in six views, each with a look of its own."""
    cameras = make_rig(clusters(0, 500), VIEWS, 640, 480)
    center = clusters(0, 500).means.mean(axis=0)
    points = (center + rng.normal(0, 2.0, (200, 3))).astype(np.float32)
    views = np.repeat(np.arange(VIEWS), 200).astype(np.int32)
    looks = rng.integers(0, 200, (VIEWS * 200, 128), dtype=np.uint8)
    return Landmarks(np.tile(points, (VIEWS, 1)), looks, views), cameras


def shown(landmarks: Landmarks, view: int, camera: Camera, few: int, rng: np.random.Generator) -> Keypoints:
    """A few of a view's landmarks where a camera sees them, their looks changed, among a thousand other things."""
    mine = np.flatnonzero(landmarks.views == view)[:few]
    places: Float64 = project(landmarks.points[mine].astype(np.float64), camera)
    looks = landmarks.descriptors[mine].astype(np.int64) + rng.integers(-60, 61, (few, 128))
    other = rng.integers(0, 200, (1000, 128))
    points = np.concatenate([places, rng.uniform((0, 0), SIZE, (1000, 2))])
    return Keypoints(points, np.concatenate([looks.clip(0, 255), other]).astype(np.uint8))


def test_a_dozen_right_ones_among_a_thousand_name_the_view_and_about_the_camera() -> None:
    rng = np.random.default_rng(0)
    landmarks, cameras = bank(rng)
    for view in (1, 4):
        true = rolled(Camera(cameras[view].viewmat, cameras[view].K, *SIZE), 2.0)
        K = true.K.copy()
        K[0, 0] *= 1.3
        K[1, 1] *= 1.3
        K[:2, 2] = SIZE[0] / 2, SIZE[1] / 2
        true = Camera(true.viewmat, K, *SIZE)
        found = vote_for_views(shown(landmarks, view, true, 12, rng), landmarks, cameras, SIZE)
        assert found[0].loudness > 1.3 * found[1].loudness
        assert found[1].loudness < 1.5, "what lies about as near as the rest says little"
        camera = found[0].camera
        assert (camera.width, camera.height) == SIZE
        assert set(found[0].keypoints) >= set(range(12))
        assert set(landmarks.views[found[0].landmarks]) == {view}
        points = landmarks.points[landmarks.views == view].astype(np.float64)
        off = np.linalg.norm(project(points, camera) - project(points, true), axis=1)
        assert np.median(off) < 10


def test_nothing_votes_for_nothing() -> None:
    landmarks, cameras = bank(np.random.default_rng(1))
    none = Keypoints(np.zeros((0, 2)), np.zeros((0, 128), np.uint8))
    assert vote_for_views(none, landmarks, cameras, SIZE) == []
    few = Landmarks(landmarks.points[:3], landmarks.descriptors[:3], landmarks.views[:3])
    assert vote_for_views(Keypoints(np.ones((9, 2)), landmarks.descriptors[:9]), few, cameras, SIZE) == []


def test_a_camera_is_found_by_votes_where_no_match_stands_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the ratio test blind, and without the bank's views, nothing is found."""
    plant = read_model(PLANT).model
    cameras = make_rig(plant, 16, 640, 480)
    landmarks = make_landmarks(plant, cameras)
    true = rolled(make_rig(plant, 1, 640, 480, jitter=np.full((1, 4), 0.3))[0], 0.7)
    picture = np.clip(render(plant, true), 0.0, 1.0)
    monkeypatch.setattr(keypoint_cameras.MatchedKeypoints, "hypotheses", lambda look, focals: [])
    assert find_camera(landmarks, plant, picture) is None
    found = find_camera(landmarks, plant, picture, bank=lambda: cameras)
    assert found is not None
    points = landmarks.points[landmarks.views == 0].astype(np.float64)
    assert np.median(np.linalg.norm(project(points, found.camera) - project(points, true), axis=1)) < 0.05


def test_landmarks_that_agree_on_a_camera_a_little_off_are_looked_at_closer(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = read_model(PLANT).model
    cameras = make_rig(plant, 16, 640, 480)
    landmarks = make_landmarks(plant, cameras)
    true = make_rig(plant, 1, 640, 480, jitter=np.full((1, 4), 0.3))[0]
    picture = np.clip(render(plant, true), 0.0, 1.0) ** 0.6
    picture[:, :260] = 0.6  # else the first look explains it at once
    off = moved(true, np.array([0.02, -0.03, 0.05, 0.03, 0.03, 0.1, 0.15, *np.zeros(4)]), 1.0)
    start = Hypothesis(off, np.ones(20, dtype=np.bool_), 1.0)
    monkeypatch.setattr(keypoint_cameras.MatchedKeypoints, "hypotheses", lambda look, focals: [start])
    monkeypatch.setattr(keypoint_cameras.MatchedKeypoints, "at_other_focals", lambda look, start, factors: iter(()))
    found = find_camera(landmarks, plant, picture)
    assert found is not None
    assert found.inliers > 100


@pytest.mark.parametrize(("turn", "scale"), [(0.0, 1.0), (0.5, 1.4), (-2.0, 0.8)])
def test_a_camera_swung_round_shows_the_middle_at_its_place(turn: float, scale: float) -> None:
    view = look_at((0, 0, -4), (0, 0, 0), (0, 1, 0), 40.0, 60, 40)
    middle, place = np.array([40.0, 12.0]), np.array([15.0, 33.0])
    seen = np.linalg.inv(view.viewmat) @ [*((middle - view.K[:2, 2]) / view.K[0, 0] * 5.0), 5.0, 1.0]
    swung_round = swung(view, middle, place, turn, scale, (48, 36))
    x, y, depth = (swung_round.viewmat @ seen)[:3]
    shown = swung_round.K @ [x / depth, y / depth, 1.0]
    assert shown[:2] == pytest.approx(place, abs=1e-6)
    assert np.linalg.norm(swung_round.position - view.position) < 1e-9, "it turns where it stands"
    assert swung_round.K[0, 0] == pytest.approx(scale * 40.0)
