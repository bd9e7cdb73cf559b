"""A picture held against renders."""

from __future__ import annotations

from dataclasses import replace

from engine.flows.views.camera_rig import make_rig
from engine.model import GaussianModel
from engine.pictures.camera.camera_trial import Picture
from engine.pictures.camera.config import Level
from engine.raster import render


def test_a_camera_is_worth_what_its_render_explains(plant: GaussianModel) -> None:
    camera = make_rig(plant, 1, 512, 384)[0]
    picture = Picture(plant, render(plant, camera))
    refined = picture.refined(camera, Level(256, 4, 0.05), mirrored=False)
    assert refined is not None
    assert refined.correlation > 0.9
    score = picture.score(refined, False)
    assert picture.score(replace(refined, correlation=0.0), False) < 0.01 * score
