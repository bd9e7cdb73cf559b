"""A model as it looks from afar."""

from __future__ import annotations

import numpy as np
import pytest

from engine.flows.views.camera_rig import make_rig
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.image_metrics import psnr
from engine.pictures.camera.camera_motion import project
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.far_views import FarViews, _aimed, _places, merged_in_voxels
from engine.raster import render
from tests.threads import with_one_and_two_threads


@pytest.fixture(scope="module")
def rig(plant: GaussianModel) -> list[Camera]:
    return make_rig(plant, 4, 640, 480)


def test_merged_it_looks_alike(plant: GaussianModel, rig: list[Camera]) -> None:
    """More than its most visible Gaussians do, of which there are more."""
    far = FarViews(plant, []).model
    enough = CONFIG.far.gaussians
    assert 0.97 * enough < len(far) < 1.03 * enough
    visible = np.argsort(-plant.opacities * np.exp(plant.log_scales.sum(axis=1) / 1.5), kind="stable")[: 3 * enough]
    whole, merged, few = (
        [render(model, camera.with_side(96)) for camera in rig] for model in (plant, far, plant.take(np.sort(visible)))
    )
    assert psnr_of(whole, merged) > 23.0
    assert psnr_of(whole, merged) > psnr_of(whole, few) + 2.0


def test_what_lies_far_away_does_not_make_voxels_coarse(plant: GaussianModel, rig: list[Camera]) -> None:
    means = plant.means.copy()
    means[:3] = 4_000.0
    small = [camera.with_side(96) for camera in rig]
    whole, merged = (
        [render(model, camera) for camera in small]
        for model in (plant, merged_in_voxels(plant.with_(means=means), CONFIG.far.gaussians))
    )
    assert psnr_of(whole, merged) > 23.0


def test_light_that_turns_quickly_is_left_out(plant: GaussianModel) -> None:
    """Four times as many numbers, of which nothing shows from afar."""
    rich = plant.with_(sh=np.pad(plant.sh, ((0, 0), (0, 15), (0, 0))))
    assert FarViews(rich, []).model.sh.shape[1:] == (4, 3)


def test_few_stay_as_they_are(plant: GaussianModel) -> None:
    assert merged_in_voxels(plant, len(plant)) is plant
    one = plant.take(np.zeros(50, np.int64))
    assert len(merged_in_voxels(one, 10)) == 1, "all in one place"


def test_views_are_taken_from_near_too(plant: GaussianModel, rig: list[Camera]) -> None:
    """At half the distance, of the same size: what bulges towards the lens looks larger."""
    views = FarViews(plant, rig[:3]).views
    assert len(views) == 6
    for away, near in zip(views[:3], views[3:], strict=True):
        assert near.depth == pytest.approx(0.5 * away.depth, rel=0.15)
        assert near.spread == pytest.approx(away.spread, rel=0.35)
        assert np.abs(near.edges - away.edges).max() > 0.05


def test_parts_lie_apart_and_are_aimed_at(plant: GaussianModel, rig: list[Camera]) -> None:
    far = FarViews(plant, rig)
    assert len(far.parts) == CONFIG.far.parts * len(rig)
    whole = far.views[: len(rig)]
    assert np.median([view.depth for view in far.parts]) < 0.5 * np.median([view.depth for view in whole])
    for view in whole:
        places = _places(view)
        assert len(places) == CONFIG.far.parts
        apart = np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(CONFIG.far.parts, 1)]
        assert apart.min() > view.spread
        ray = np.linalg.solve(view.camera.K, np.array([*places[0], 1.0]))
        camera = _aimed(view, places[0])
        on_it = (ray * view.depth - view.camera.viewmat[:3, 3]) @ view.camera.viewmat[:3, :3]
        assert project(on_it[None], camera)[0] == pytest.approx((camera.width / 2, camera.height / 2), abs=0.5)


def test_side_by_side_or_in_turn_they_are_the_same(plant: GaussianModel, rig: list[Camera]) -> None:
    in_turn, side_by_side = with_one_and_two_threads(lambda: FarViews(plant, rig).views)
    for one, other in zip(in_turn, side_by_side, strict=True):
        np.testing.assert_array_equal(one.edges, other.edges)
        np.testing.assert_array_equal(one.colors, other.colors)


def psnr_of(whole: list[Float32], other: list[Float32]) -> float:
    return float(np.mean([psnr(a, b) for a, b in zip(whole, other, strict=True)]))
