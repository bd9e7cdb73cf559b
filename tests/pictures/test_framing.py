"""Where somebody's viewer ends: pages and bars around what shows the model."""

from __future__ import annotations

import numpy as np
import pytest

from engine.flows.views.camera_rig import make_rig
from engine.model import Camera, Float32, GaussianModel
from engine.pictures.camera.camera_search import FoundCamera
from engine.pictures.camera.viewer_frame import find_frame
from engine.pictures.landmarks.keypoints import luma
from engine.raster import render


def close(model: GaussianModel) -> Camera:
    """A view of 600 x 300 pixels, larger than which the model is."""
    camera = make_rig(model, 1, 600, 450, jitter=np.full((1, 4), 0.3))[0]
    K = camera.K.copy()
    K[0, 0], K[1, 1] = 1.5 * K[0, 0], 1.5 * K[1, 1]
    K[1, 2] -= 75.0
    return Camera(camera.viewmat, K, 600, 300)


def on_page(shown: Float32, color: float) -> Float32:
    page = np.full((500, 700, 3), color, dtype=np.float32)
    page[120:420, 40:640] = shown
    return page


@pytest.mark.parametrize("color", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("tone", [1.0, 2.2])
def test_the_page_around_a_viewer_is_cut_off(plant: GaussianModel, color: float, tone: float) -> None:
    camera = close(plant)
    shown = np.clip(render(plant, camera), 0.0, 1.0) ** np.float32(1.0 / tone)
    K = camera.K.copy()
    K[:2, 2] += 40.0, 120.0
    frame = find_frame(plant, luma(on_page(shown, color)), Camera(camera.viewmat, K, 700, 500))
    assert frame is not None
    rows, columns = frame
    assert abs(rows.start - 120) < 30
    assert abs(rows.stop - 420) < 30
    assert columns.start < 80
    assert columns.stop > 600


def test_a_picture_that_shows_it_everywhere_has_no_frame(plant: GaussianModel) -> None:
    camera = close(plant)
    picture = np.clip(render(plant, camera), 0.0, 1.0)
    assert find_frame(plant, luma(picture), camera) is None
    noise = np.random.default_rng(0).random((300, 600)).astype(np.float32)
    assert find_frame(plant, noise, camera) is None  # hardly anywhere
    away = Camera(np.diag([-1.0, 1.0, -1.0, 1.0]) @ camera.viewmat, camera.K, 600, 300)
    assert find_frame(plant, luma(picture), away) is None


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_camera_of_the_part_and_of_the_whole_show_the_same(plant: GaussianModel, mirrored: bool) -> None:
    part = close(plant)
    found = FoundCamera(part, 0, 0.0, 1.0, 0.0, mirrored=mirrored, frame=(slice(120, 420), slice(40, 640)))
    page = on_page(np.zeros((300, 600, 3), np.float32), 0.0)
    whole = found.of_whole(page)
    assert (whole.width, whole.height) == (700, 500)
    drawn = render(plant, whole)
    drawn = drawn[:, ::-1] if mirrored else drawn
    np.testing.assert_allclose(found.face(np.ascontiguousarray(drawn)), render(plant, part), atol=5e-3)
    bare = FoundCamera(part, 0, 0.0, 1.0, 0.0, mirrored=mirrored)
    assert bare.of_whole(page) is part
