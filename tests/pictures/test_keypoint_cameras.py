"""A closer look at where the model is: small in a picture full of other things."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from skimage import data

from engine.flows.views.camera_rig import make_rig
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.resampling import smooth
from engine.pictures.camera.camera_motion import moved, project
from engine.pictures.camera.camera_proposals import Candidates
from engine.pictures.camera.camera_trial import Picture
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.keypoint_cameras import MatchedKeypoints, Window, keypoints_of, match_closer, match_near
from engine.pictures.camera.pose_ransac import Hypothesis
from engine.pictures.landmarks.keypoints import luma
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from engine.raster import render_depth

OFF = np.array([0.01, -0.02, 0.03, 0.02, 0.0, 0.03, 0.03, *np.zeros(4)])


def small_view(model: GaussianModel, zoom: float) -> Camera:
    """A view of 1,000 by 800 pixels with the model left of the middle."""
    base = make_rig(model, 1, 1000, 800, jitter=np.full((1, 4), 0.3))[0]
    aside = moved(base, np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0, np.log(zoom), *np.zeros(4)]), 1.0)
    return aside


def busy(model: GaussianModel, camera: Camera) -> Float32:
    """(H, W) the view over a wall of bricks, whose keypoints are the stronger ones."""
    image, alpha, _ = render_depth(model, camera)
    return luma(image) + (1.0 - alpha) * wall(camera)


def wall(camera: Camera) -> Float32:
    """(H, W) the bricks alone."""
    return np.tile(data.brick().astype(np.float32) / np.float32(255.0), (2, 2))[: camera.height, : camera.width]


def test_the_window_holds_the_model_and_goes_back(plant: GaussianModel) -> None:
    camera = small_view(plant, 0.4)
    window = Window.around(plant, camera, busy(plant, camera))
    assert window is not None
    _, alpha, _ = render_depth(plant, camera)
    rows, columns = np.nonzero(alpha > 0.6)
    assert window.rows.start <= rows.min() <= rows.max() < window.rows.stop
    assert window.columns.start <= columns.min() <= columns.max() < window.columns.stop
    near = window.of(camera)
    points = plant.means[::500].astype(np.float64)
    corner = np.array([window.columns.start, window.rows.start])
    np.testing.assert_allclose(project(points, near), window.factor * (project(points, camera) - corner), atol=1e-6)
    again = window.back(near)
    np.testing.assert_allclose(again.K, camera.K)
    assert (again.width, again.height) == (1000, 800)


def test_what_is_out_of_sight_is_not_looked_for(plant: GaussianModel) -> None:
    camera = small_view(plant, 1.0)
    away = moved(camera, np.array([0.0, np.pi, *np.zeros(9)]), 1.0)
    assert Window.around(plant, away, busy(plant, camera)) is None
    assert match_closer(plant, busy(plant, camera), away) is None


@pytest.mark.parametrize("zoom", [0.4, 0.55])
def test_a_small_model_among_other_things_is_found_from_nearly_there(plant: GaussianModel, zoom: float) -> None:
    true = small_view(plant, zoom)
    gray = busy(plant, true)
    rough = moved(true, OFF, 2.0)
    found = match_closer(plant, gray, rough)
    assert found is not None
    assert found.support >= 30
    points = plant.means[::500].astype(np.float64)
    assert np.median(np.linalg.norm(project(points, found.camera) - project(points, true), axis=1)) < 1.0


def test_a_glance_tells_what_is_worth_a_look(plant: GaussianModel) -> None:
    true = small_view(plant, 0.55)
    rough = moved(true, OFF, 2.0)
    image, alpha, _ = render_depth(plant, true)
    seen, nothing = luma(image), 1.0 - alpha
    like = {
        "over bricks": busy(plant, true),
        "light and dark exchanged": alpha - seen + 0.5 * nothing,
        "steps washed out": smooth(seen, 30.0),
        "over white": seen + nothing,
    }
    for name, gray in like.items():
        window = Window.around(plant, rough, gray)
        assert window is not None, name
        assert window.resemblance > 0.6, name
    for other in (wall(true), busy(plant, true)[:, ::-1]):
        assert Window.around(plant, rough, other) is not None
        assert match_near(plant, other, rough) is None
        assert match_closer(plant, other, rough) is None


def test_a_camera_that_enough_agree_on_is_tried_before_another_is_sought(
    plant: GaussianModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = make_rig(plant, 1, 640, 480)[0]
    bank = make_landmarks(plant, [camera])
    look = MatchedKeypoints.of(keypoints_of(luma(render_depth(plant, camera)[0])), bank, (640, 480))
    asked: list[int] = []
    kept = MatchedKeypoints.agreed

    def counted(self: MatchedKeypoints, *pairs: Any) -> Any:
        asked.append(len(pairs[0]))
        return kept(self, *pairs)

    monkeypatch.setattr(MatchedKeypoints, "agreed", counted)
    found = look.hypotheses((1.0, 1.1))
    assert next(found).support >= CONFIG.keypoints.enough
    assert len(asked) == 1
    assert next(found).support >= CONFIG.keypoints.least_inliers
    assert len(asked) == len(look.matches) == 2


@pytest.mark.parametrize(
    ("support", "lenses"), [(CONFIG.keypoints.least_freed - 1, 0), (CONFIG.keypoints.least_freed, 2)]
)
def test_few_keypoints_say_little_of_the_lens(
    plant: GaussianModel, monkeypatch: pytest.MonkeyPatch, support: int, lenses: int
) -> None:
    start = Hypothesis(make_rig(plant, 1, 320, 240)[0], np.ones(support, np.bool_), 1.0)
    monkeypatch.setattr(MatchedKeypoints, "hypotheses", lambda *asked: iter([start]))
    monkeypatch.setattr(MatchedKeypoints, "at_other_focals", lambda *asked: iter([start] * 2))
    monkeypatch.setattr(Candidates, "_closer", lambda *asked: None)
    none = Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.int32))
    picture = Picture(plant, render_depth(plant, start.camera)[0])
    assert len(list(Candidates(picture, none, (), ()).by_keypoints(False))) == 1 + lenses
