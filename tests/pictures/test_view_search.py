"""Views held against a picture by their edges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.formats import read_model
from engine.model import GaussianModel
from engine.pictures import picture_edges
from engine.pictures.camera_motion import project
from engine.pictures.picture_edges import PictureEdges
from engine.pictures.view_points import thinned
from engine.pictures.view_scores import BINS, PAD, ROLLS, SIDE, look_again, score_views
from engine.pictures.view_search import PARTS, RADII, _aimed, _places, describe_views, search_views
from engine.pipeline.rigs import make_rig
from engine.raster import render_depth
from tests.pictures.rolling import rolled
from tests.reference.view_scores import score

PLANT = Path(__file__).parents[1] / "data" / "plant.splat"


@pytest.fixture(scope="module")
def plant() -> GaussianModel:
    return thinned(read_model(PLANT).model, 20_000)


def test_kernels_say_what_their_twin_says() -> None:
    rng = np.random.default_rng(0)
    picture = rng.random((60, SIDE, 3)).astype(np.float32)
    maps, inside = picture_edges._responses(picture, 2)
    whole, within = picture_edges.whole(maps, inside)
    assert within.sum() == 60 * SIDE
    responses = whole[:, PAD : PAD + 60, PAD : PAD + SIDE]
    np.testing.assert_allclose(responses.mean(axis=(1, 2)), 0.0, atol=1e-4)
    np.testing.assert_allclose(responses.std(axis=(1, 2)), 1.0, rtol=1e-3)
    places = rng.normal(size=(2, 30, 2)).astype(np.float32)
    directions = rng.uniform(-np.pi, np.pi, (2, 30)).astype(np.float32)
    radii = np.array(RADII[:3], dtype=np.float32)
    scores, found = np.empty((2, ROLLS, 3), np.float32), np.empty((2, ROLLS, 3, 2), np.int64)
    score_views(maps, places, directions, radii, np.array([60, SIDE]), scores, found)
    for view, roll, size in ((0, 0, 0), (1, 7, 1), (0, 23, 2)):
        asked = (places[view], directions[view])
        angle = 2.0 * np.pi * roll / ROLLS
        best, seen = score(responses, *asked, found[view, roll, size], angle, radii[size], BINS)
        assert scores[view, roll, size] == pytest.approx(best, rel=1e-3)
        assert seen >= 0.35 * 30
        for _ in range(200):  # nowhere is better
            place = 2 * rng.integers(-10, 50, 2)
            other, seen = score(responses, *asked, place, angle, radii[size], BINS)
            assert seen < 0.35 * 30 or other <= best + 1e-3
    starts = np.array([[0.1, 20.0, 40.0, 30.0]])
    fine, poses = np.empty(1, np.float32), np.empty((1, 4))
    look_again(whole, within, places, directions, np.array([1]), starts, fine, poses)
    again, _ = score(responses, places[1], directions[1], poses[0, 2:].astype(int), poses[0, 0], poses[0, 1], BINS)
    assert fine[0] == pytest.approx(again, rel=1e-3)
    assert fine[0] >= score(responses, places[1], directions[1], np.array([40, 30]), 0.1, 20.0, BINS)[0] - 1e-3
    assert np.abs(poses[0] - starts[0]).max() <= 2.3


@pytest.mark.parametrize("roll", [0.0, 130.0])
def test_the_view_is_found_over_white(plant: GaussianModel, roll: float) -> None:
    """The camera stands between those of the views and is turned; none of its edges against the white is in theirs."""
    rig = make_rig(plant, 24, 640, 480)
    true = rolled(make_rig(plant, 1, 640, 480, jitter=np.array([[0.3, 0.6, 0.4, 0.5]]))[0], np.radians(roll))
    image, alpha, _ = render_depth(plant, true)
    picture = np.clip(image + 1.0 - alpha[..., None], 0.0, 1.0)
    found = search_views(describe_views(plant, rig), PictureEdges.of(picture), 5)
    true = true.with_side(SIDE)
    points = plant.means[plant.opacities > 0.9][:500].astype(np.float64)
    errors = [np.median(np.linalg.norm(project(points, camera) - project(points, true), axis=1)) for _, camera in found]
    assert min(errors) < 0.06 * SIDE
    assert [score for score, _ in found] == sorted((score for score, _ in found), reverse=True)
    assert all((camera.width, camera.height) == (96, 72) for _, camera in found)


def test_nothing_to_see_is_no_view(plant: GaussianModel) -> None:
    away = [rolled(camera, 0.0) for camera in make_rig(plant.with_(means=plant.means + 1000.0), 2, 64, 48)]
    assert describe_views(plant, away) == []
    assert search_views([], PictureEdges.of(np.zeros((48, 64, 3), np.float32)), 3) == []


def test_a_thinned_model_covers_what_the_whole_one_did(plant: GaussianModel) -> None:
    camera = make_rig(plant, 1, 96, 72)[0]
    few = thinned(plant, 5_000)
    assert len(few) == 5_000
    assert thinned(plant, len(plant)) is plant
    (whole, alpha, _), (rough, covered, _) = (render_depth(model, camera) for model in (plant, few))
    assert covered.sum() == pytest.approx(alpha.sum(), rel=0.2)
    assert np.corrcoef(whole.ravel(), rough.ravel())[0, 1] > 0.9


def test_views_are_taken_from_near_too(plant: GaussianModel) -> None:
    """At half the distance, of the same size: what bulges towards the lens looks larger."""
    rig = make_rig(plant, 3, 640, 480)
    views = describe_views(plant, rig)
    assert len(views) == 6
    for away, near in zip(views[:3], views[3:], strict=True):
        assert near.depth == pytest.approx(0.5 * away.depth, rel=0.15)
        assert near.spread == pytest.approx(away.spread, rel=0.35)
        assert np.abs(near.edges - away.edges).max() > 0.05


def test_parts_lie_apart_and_are_aimed_at(plant: GaussianModel) -> None:
    rig = make_rig(plant, 4, 640, 480)
    for view in describe_views(plant, rig)[: len(rig)]:
        places = _places(view)
        assert len(places) == PARTS
        apart = np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(PARTS, 1)]
        assert apart.min() > view.spread
        ray = np.linalg.solve(view.camera.K, np.array([*places[0], 1.0]))
        camera = _aimed(view, places[0])
        on_it = (ray * view.depth - view.camera.viewmat[:3, 3]) @ view.camera.viewmat[:3, :3]
        assert project(on_it[None], camera)[0] == pytest.approx((camera.width / 2, camera.height / 2), abs=0.5)
