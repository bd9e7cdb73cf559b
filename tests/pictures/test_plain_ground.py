"""Something small on a plain ground is searched by itself."""

from __future__ import annotations

import numpy as np
import pytest

from engine.flows.verify.suspect_evidence import far_views
from engine.flows.views.camera_rig import direction, measure_extent
from engine.model import Camera, Float32, GaussianModel, look_at
from engine.pictures.camera.camera_search import find_camera, find_subject
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from engine.raster import render_depth
from tests.pictures.plant_views import UP, around, jpeg, reprojection


def painted(height: int, width: int, ground: float, *parts: tuple[slice, slice]) -> Float32:
    image = np.full((height, width, 3), ground, dtype=np.float32)
    for part in parts:
        image[part] = np.random.default_rng(1).uniform(0.2, 0.4, image[part].shape)
    return image


def portrait(model: GaussianModel, camera: Camera, ground: float) -> Float32:
    image, alpha, _ = render_depth(model, camera)
    return jpeg(image + (1.0 - alpha[..., None]) * ground, 80)


@pytest.mark.parametrize("ground", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(("height", "width"), [(600, 800), (844, 390), (61, 47)])
def test_what_is_shown_lies_within_and_the_middle_stays_the_middle(ground: float, height: int, width: int) -> None:
    top, left = height // 3, width // 4
    thing = slice(top, top + height // 4), slice(left, left + width // 3)
    for image in (painted(height, width, ground, thing), jpeg(painted(height, width, ground, thing), 50)):
        found = find_subject(image)
        assert found is not None
        for part, inner, side in zip(found, thing, (height, width), strict=True):
            assert part.start <= inner.start
            assert part.stop >= inner.stop
            assert part.start == side - part.stop
        assert find_subject(image[found]) is None, "there is nothing left to cut off"


def test_buttons_do_not_matter_and_other_pictures_stay_whole() -> None:
    thing, button = (slice(220, 420), slice(300, 500)), (slice(570, 590), slice(760, 780))
    assert find_subject(painted(600, 800, 1.0, thing, button)) == find_subject(painted(600, 800, 1.0, thing))
    assert find_subject(painted(600, 800, 1.0, (slice(10, 590), slice(10, 790)))) is None
    assert find_subject(painted(600, 800, 1.0)) is None
    assert find_subject(np.random.default_rng(0).random((600, 800, 3)).astype(np.float32)) is None
    slope = np.broadcast_to(np.linspace(0, 1, 800, dtype=np.float32)[:, None], (600, 800, 3)).copy()
    assert find_subject(slope) is None


@pytest.mark.slow
@pytest.mark.parametrize("elevation", [pytest.param(-5.0, marks=pytest.mark.long), 40.0])
def test_a_small_model_without_keypoints_is_found_in_a_portrait(plant: GaussianModel, elevation: float) -> None:
    nothing = make_landmarks(plant, [look_at((0.0, 0.0, -100.0), (0.0, 0.0, -200.0), UP, 300.0, 64, 48)])
    near = around(plant, 77.0, elevation, 3.6, 1.1)
    K = near.K.copy()
    K[:2, 2] = 195.0, 422.0
    true = Camera(near.viewmat, K, 390, 844)
    picture = portrait(plant, true, 0.5)
    found = find_camera(nothing, plant, picture, far=lambda: far_views(plant))
    assert found is not None
    assert reprojection(plant, true, found.of_whole(picture)) < 0.3


@pytest.mark.parametrize("flat", [False, True])
def test_flat_ground_is_looked_at_edge_on_too(plant: GaussianModel, flat: bool) -> None:
    """A climb gets some 25 degrees far: from every side of an object one of the views is nearer."""
    model = plant.with_(means=plant.means * np.float32([1.0, 0.05 if flat else 1.0, 1.0]))
    center = measure_extent(model).center
    seen = np.array([view.camera.position - center for view in far_views(model).views])
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    for elevation in (-10.0, 0.0, 20.0, 45.0, 70.0):
        for azimuth in range(0, 360, 30):
            toward = direction(np.radians(azimuth), np.radians(elevation))
            assert np.degrees(np.arccos((seen @ toward).max())) < 25.0
