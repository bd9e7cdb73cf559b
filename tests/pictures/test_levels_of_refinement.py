"""What one level of a camera's refinement leaves to the next."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.model import Camera, Float32, GaussianModel
from engine.pictures.camera import camera_trial, pose_refinement
from engine.pictures.camera.camera_motion import moved
from engine.pictures.camera.camera_search import find_camera
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.pose_refinement import Refined, refine_level
from engine.pictures.landmarks.keypoints import luma
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import RasterSettings, render
from tests.pictures.plant_views import around, jpeg, reprojection

pytestmark = pytest.mark.slow


def test_what_is_known_of_a_camera_is_not_forgotten_at_the_next_size(
    plant: GaussianModel, bank: Landmarks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each level of a refinement that begins anew takes a render for each of the wide blurs; and what is neither
    cropped nor drawn otherwise needs no camera for that."""
    true = around(plant, 100.0, 25.0, 1.5, 1.4).with_side(960)
    asked: list[tuple[int, float]] = []
    drawn: list[int] = []
    refine, draw = camera_trial.refine_level, pose_refinement.render_depth

    def noted(model: GaussianModel, picture: Float32, camera: Camera, *how: Any, **more: Any) -> Refined | None:
        asked.append((camera.width, more["max_error"]))
        return refine(model, picture, camera, *how, **more)

    def counted(model: GaussianModel, camera: Camera, **settings: RasterSettings) -> tuple[Float32, Float32, Float32]:
        drawn.append(camera.width)
        return draw(model, camera, **settings)

    monkeypatch.setattr(camera_trial, "refine_level", noted)
    monkeypatch.setattr(pose_refinement, "render_depth", counted)
    found = find_camera(bank, plant, jpeg(render(plant, true), 80))
    assert found is not None
    assert reprojection(plant, true, found.camera) < 0.05
    assert [width for width, _ in asked] == [640] * 2 + [960] * 4, (
        "each drawn otherwise, too, the last by three low passes"
    )
    assert max(off for width, off in asked if width == 960) < 1.0
    assert drawn.count(960) <= 6  # three, and three drawn otherwise


def test_a_camera_known_to_be_near_is_spared_wide_blurs(plant: GaussianModel) -> None:
    true = around(plant, 100.0, 25.0, 1.5, 1.4)
    picture = luma(render(plant, true))
    near = moved(true, np.array([2e-4, -2e-4, *np.zeros(9)]), 1.0)
    for off, iterations in ((0.3, 2), (np.inf, 3)):  # of the blurs 3, 1.5 and 0.8 only the last ends it
        few = refine_level(plant, picture, near, iterations, 0.5, max_error=off)
        enough = refine_level(plant, picture, near, 9, 0.5, max_error=off)
        assert few is not None
        assert enough is not None
        assert few.rms == enough.rms


def test_what_freeing_the_middle_of_a_picture_moves_tells_whether_it_was_cropped(plant: GaussianModel) -> None:
    true = around(plant, 100.0, 25.0, 1.5, 1.4)
    picture = luma(render(plant, true))
    own = refine_level(plant, picture, true, 8, 0.005)
    K = true.K.copy()
    K[:2, 2] += 12.0, 8.0
    wrong = refine_level(plant, picture, Camera(true.viewmat, K, true.width, true.height), 30, 0.005)
    assert own is not None
    assert wrong is not None
    assert max(own.shift, own.step, wrong.step) < 0.01 < CONFIG.free_step < wrong.shift
