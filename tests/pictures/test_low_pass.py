"""Screenshots that were reduced or enlarged since: renders look like them with the low pass of the size they had."""

from __future__ import annotations

import numpy as np
import pytest

from engine.model import GaussianModel
from engine.numerics.resampling import resized
from engine.pictures.camera import camera_search
from engine.pictures.camera.camera_proposals import Candidate
from engine.pictures.camera.camera_trial import Picture
from engine.raster import RasterSettings, render
from tests.pictures.plant_views import around


@pytest.mark.parametrize(("drawn", "low_pass"), [(640, 0.15), (480, 0.3), (240, 1.2)])
def test_the_low_pass_is_that_of_the_size_a_picture_was_drawn_in(
    plant: GaussianModel, monkeypatch: pytest.MonkeyPatch, drawn: int, low_pass: float
) -> None:
    camera = around(plant, 40.0, 20.0, 0.7, 0.8)
    image = np.clip(render(plant, camera.with_side(drawn)), 0.0, 1.0)
    picture = Picture(plant, np.stack([resized(plane, 480, 360) for plane in np.moveaxis(image, 2, 0)], axis=2))
    best = camera_search._best_candidate(picture, [Candidate(camera, False, 0)])
    assert best is not None
    found = camera_search._refine_to_full_size(picture, best)
    assert found is not None
    assert found.settings == RasterSettings(eps2d=low_pass)
    monkeypatch.setattr(camera_search, "_with_own_low_pass", lambda *given: (given[1], given[4]))
    plain = camera_search._refine_to_full_size(picture, best)
    assert plain is not None
    assert (found.gain == plain.gain) if drawn == 480 else (found.gain > 1.05 * plain.gain)
