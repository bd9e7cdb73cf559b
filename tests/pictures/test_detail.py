"""Detail tells a picture of the asset from one that is light and dark in the same places, or alike on a small piece."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.model import GaussianModel, look_at
from engine.numerics.resampling import resized, smooth
from engine.pictures.alignment.detail import compare_detail, uncovered
from engine.pictures.camera import pose_refinement
from engine.pictures.camera.camera_search import find_camera
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.far_views import FarViews
from engine.pictures.landmarks.keypoints import luma
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import render, render_depth
from tests.pictures.plant_views import UP, around

pytestmark = pytest.mark.slow


def test_what_is_light_and_dark_in_the_same_places_is_no_picture_of_it(plant: GaussianModel) -> None:
    """A guitar's body was once taken for a flower pot: brightness alone correlated by 0.78."""
    none = Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.int32))
    views = [around(plant, 90.0 * k, 30.0, 1.3, 1.1) for k in range(4)]
    image, alpha, _ = render_depth(plant, views[1])
    far = FarViews(plant, views)
    other = np.ascontiguousarray(render(plant, views[3])[:, ::-1])
    wide = max(alpha.shape) / 50
    coarse = smooth(image, wide) / np.maximum(smooth(alpha, wide), 0.05)[..., None]
    alike = np.clip(alpha[..., None] * (coarse + 0.5 * (other - smooth(other, wide))), 0.0, 1.0)
    camera = views[1].with_side(640)
    gray = resized(luma(alike), camera.width, camera.height)
    refined = pose_refinement.refine_level(plant, gray, camera, 8, 0.05)
    assert refined is not None
    assert refined.correlation > CONFIG.refinement.least_correlation, "as large as that of a picture of it"
    assert find_camera(none, plant, alike, far=lambda: far) is None


def test_single_pixels_have_no_detail() -> None:
    few = np.zeros((900, 1600), dtype=np.bool_)
    few[::40, ::40] = True
    picture = np.random.default_rng(0).random(few.shape).astype(np.float32)
    camera = look_at((0.0, 0.0, -4.0), (0.0, 0.0, 0.0), UP, 1600.0, 1600, 900)
    assert compare_detail(picture, picture, np.ones_like(picture), few, camera) == (0.0, 0.0)


def test_an_outline_alone_is_no_detail() -> None:
    """What has the same shape and another texture is alike only where both end."""
    rng = np.random.default_rng(0)
    row, column = np.mgrid[0:480, 0:480]
    cover = smooth((np.hypot(row % 160 - 80, column % 160 - 80) < 50).astype(np.float32), 2.0)
    textures = [smooth(rng.normal(size=cover.shape).astype(np.float32), 3.0) for _ in range(2)]
    one, other = (cover * (0.5 + 0.1 * texture / texture.std()) for texture in textures)
    camera = look_at((0.0, 0.0, -4.0), (0.0, 0.0, 0.0), UP, 480.0, 480, 480)
    everywhere = np.ones(cover.shape, dtype=np.bool_)
    assert abs(compare_detail(one, other, cover, everywhere, camera).correlation) < 0.2
    assert compare_detail(one, one, cover, everywhere, camera).correlation > 0.99


def test_a_small_piece_alike_by_chance_is_no_picture_of_it(plant: GaussianModel) -> None:
    """A few strokes of a drawing once fitted a small part of a statue: a large one says more."""
    camera = around(plant, 90.0, 30.0, 1.3, 1.1)
    gray = luma(np.clip(render(plant, camera), 0.0, 1.0))
    noise = smooth(np.random.default_rng(0).normal(size=gray.shape).astype(np.float32), 4.0)
    noise *= 0.1 * gray.std() / noise.std()
    told = {}
    for name, part in (("whole", 1), ("part", 8)):
        shown = np.zeros(gray.shape, dtype=np.bool_)
        middle = tuple(slice(side // 2 - side // 2 // part, side // 2 + side // 2 // part) for side in gray.shape)
        shown[middle] = True
        told[name] = compare_detail(gray + noise, gray, np.ones_like(gray), shown, camera)
    assert told["whole"][0] == pytest.approx(told["part"][0], abs=0.2)
    assert told["whole"][1] > 4.0 * told["part"][1] > 0.0
    refined = pose_refinement.refine_level(plant, gray, camera, 8, 0.05)
    assert refined is not None
    assert refined.alike
    assert refined.detail_z > CONFIG.refinement.least_detail_z
    assert not replace(refined, detail_z=CONFIG.refinement.least_detail_z - 1.0).alike
    assert not replace(refined, uncovered_correlation=CONFIG.refinement.least_correlation - 0.01).alike


def test_what_lies_over_the_model_is_left_out(plant: GaussianModel) -> None:
    """A viewer's panel, of a tenth of what the model fills, halves what correlation says of the right camera."""
    camera = around(plant, 90.0, 30.0, 0.8, 1.1)
    picture = luma(np.clip(render(plant, camera), 0.0, 1.0))
    rows, columns = (slice(side // 2, side // 2 + side // 4) for side in picture.shape)
    picture[rows, columns] = 0.08 + 0.1 * picture[rows, columns]
    small = camera.with_side(320)
    refined = pose_refinement.refine_level(plant, resized(picture, small.width, small.height), small, 8, 0.05)
    assert refined is not None
    assert refined.correlation < 0.8
    assert refined.uncovered_correlation > 0.97
    assert refined.alike


def test_only_so_much_may_be_covered() -> None:
    """And noise everywhere covers nothing."""
    rng = np.random.default_rng(0)
    used = np.ones((120, 240), dtype=np.bool_)
    used[:, :40] = False
    noise = 0.01 * rng.normal(size=used.shape).astype(np.float32)
    np.testing.assert_array_equal(uncovered(noise, used, 0.01), used)
    panel = noise.copy()
    panel[10:50, 100:130] += 0.3
    clear = uncovered(panel, used, 0.01)
    assert not clear[10:50, 100:130].any()
    assert clear.sum() == used.sum() - 40 * 30
    wrong = noise + np.where(np.arange(240) < 140, np.linspace(0.4, 0.2, 240), 0.0).astype(np.float32)
    clear = uncovered(wrong, used, 0.01)
    assert 0.84 < clear.sum() / used.sum() < 0.88, "half of it is, and most stays in"
    assert not clear[:, 40:60].any(), "the worst goes"
