"""The camera of a frame follows from that of the frame before; a cut to another view is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.model import Float32, GaussianModel
from engine.pictures.camera.camera_search import FoundCamera, find_camera, follow_camera
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import render
from tests.pictures.plant_views import around, jpeg, reprojection

pytestmark = pytest.mark.slow


def frame(plant: GaussianModel, azimuth: float) -> Float32:
    return jpeg(render(plant, around(plant, azimuth, 25.0, 1.4, 1.2)), 80)


@pytest.fixture(scope="module")
def first(plant: GaussianModel, bank: Landmarks) -> FoundCamera:
    found = find_camera(bank, plant, frame(plant, 100.0))
    assert found is not None
    return found


def test_a_frame_is_followed_as_well_as_searched(plant: GaussianModel, bank: Landmarks, first: FoundCamera) -> None:
    for azimuth in (101.5, 96.0):
        picture = frame(plant, azimuth)
        followed, searched = follow_camera(plant, picture, first), find_camera(bank, plant, picture)
        assert followed is not None
        assert searched is not None
        assert reprojection(plant, searched.camera, followed.camera) < 0.2
        assert reprojection(plant, around(plant, azimuth, 25.0, 1.4, 1.2), followed.camera) < 0.2


def test_how_the_last_frame_was_turned_and_framed_is_kept(plant: GaussianModel, first: FoundCamera) -> None:
    page = np.full((420, 600, 3), 0.4, np.float32)
    rows, columns = slice(30, 390), slice(100, 580)
    page[rows, columns] = frame(plant, 101.5)
    last = FoundCamera(first.camera, 0, 0.0, 0.99, 0.0, mirrored=True, frame=(rows, slice(20, 500)))
    followed = follow_camera(plant, np.ascontiguousarray(page[:, ::-1]), last)
    assert followed is not None
    assert followed.mirrored
    assert followed.frame == last.frame
    assert reprojection(plant, around(plant, 101.5, 25.0, 1.4, 1.2), followed.camera) < 0.2


def test_what_is_elsewhere_or_otherwise_is_not_followed(plant: GaussianModel, first: FoundCamera) -> None:
    assert follow_camera(plant, frame(plant, 250.0), first) is None  # a cut
    assert follow_camera(plant, frame(plant, 101.5)[:-8], first) is None  # another size
    assert follow_camera(plant, np.zeros((360, 480, 3), dtype=np.float32), first) is None
    assert follow_camera(plant, np.full((360, 480, 3), np.nan, dtype=np.float32), first) is None


def test_what_explains_a_frame_less_well_than_a_found_camera_must_is_searched(
    plant: GaussianModel, first: FoundCamera
) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.6, (360, 480, 3)).astype(np.float32)
    noisy = jpeg(frame(plant, 101.5) + noise, 80)
    assert follow_camera(plant, noisy, first) is None
    assert follow_camera(plant, noisy, replace(first, correlation=0.6)) is not None  # the last was no better
