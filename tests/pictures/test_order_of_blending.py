"""Viewers that sort by distance: large Gaussians beside a wide lens come in another order than their depth's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.model import GaussianModel
from engine.pictures.camera import camera_search
from engine.pictures.camera.camera_proposals import Candidate
from engine.pictures.camera.camera_search import follow_camera
from engine.pictures.camera.camera_trial import Picture
from engine.pictures.camera.config import Level
from engine.pictures.camera.pose_refinement import DEFAULT_SETTINGS, Refined
from engine.raster import RasterSettings, render
from tests.pictures.plant_views import around


@pytest.fixture(scope="module")
def veiled(plant: GaussianModel) -> GaussianModel:
    """The plant, with large ones among its Gaussians, as blurred captures have them."""
    large = plant.take(np.arange(0, len(plant), len(plant) // 100))
    grown = np.full_like(large.log_scales, np.log(0.11))
    large = large.with_(log_scales=grown, opacity_logits=np.full(len(large), 2.0, np.float32))
    fields = ("means", "log_scales", "quats", "opacity_logits", "sh")
    return GaussianModel(*(np.concatenate([getattr(plant, name), getattr(large, name)]) for name in fields))


@pytest.mark.parametrize("by_distance", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_picture_is_explained_in_the_order_it_was_drawn_in(
    veiled: GaussianModel, monkeypatch: pytest.MonkeyPatch, by_distance: bool
) -> None:
    camera = around(veiled, 40.0, 20.0, 0.7, 0.5)
    drawn = RasterSettings(by_distance=by_distance)
    image = np.clip(render(veiled, camera, settings=drawn), 0.0, 1.0)
    picture = Picture(veiled, image)
    weigh, weighed = picture.score, []

    def noted(refined: Refined, mirrored: bool, how: RasterSettings = DEFAULT_SETTINGS) -> float:
        weighed.append(how)
        return weigh(refined, mirrored, how)

    with monkeypatch.context() as watched:
        watched.setattr(picture, "score", noted)
        best = camera_search._best_candidate(picture, [Candidate(camera, False, 0)])
    assert best is not None
    assert best.settings == drawn
    assert best.correlation > 0.999
    found = camera_search._refine_to_full_size(picture, best)
    assert found is not None
    assert found.settings == drawn
    np.testing.assert_array_equal(found.camera.K[:2, 2], [240.0, 180.0])  # no other place of the middle makes up for it
    assert found.correlation > 0.999
    wrong = picture.refined(
        camera, Level(480, 8, 0.05), mirrored=False, settings=RasterSettings(by_distance=not by_distance)
    )
    assert wrong is not None
    assert wrong.correlation < 0.99
    right = picture.refined(camera, Level(best.side, 8, 0.05), mirrored=False, settings=drawn)
    assert right is not None
    other = RasterSettings(by_distance=not by_distance)
    assert picture.score(right, False, drawn) > 1.01 * picture.score(right, False, other)
    assert weighed == [drawn]
    kept, asked = Picture.refined, []

    def counted(self: Picture, *how: Any, **more: Any) -> Refined | None:
        asked.append(how)
        return kept(self, *how, **more)

    monkeypatch.setattr(Picture, "refined", counted)
    assert follow_camera(veiled, image, found) is not None
    in_order = len(asked)
    following = follow_camera(veiled, image, replace(found, settings=RasterSettings()))
    assert following is not None
    assert following.settings.by_distance is by_distance, "the next frame is asked anew"
    assert by_distance is (len(asked) - in_order > in_order), "which costs more than beginning in the order of the last"
