"""Views held against a picture by their edges."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.flows.views.camera_rig import make_rig
from engine.model import GaussianModel
from engine.pictures.camera import picture_edges, view_search
from engine.pictures.camera.camera_motion import project
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.far_views import FarViews
from engine.pictures.camera.picture_edges import PictureEdges
from engine.pictures.camera.view_scores import BINS, PAD, ROLLS, SIDE, STEP, folded, look_again, score_views, spread_out
from engine.pictures.camera.view_search import search_views
from engine.raster import render_depth
from tests.pictures.rolling import rolled
from tests.reference.view_scores import score, strongest_apart


def test_kernels_say_what_their_twin_says() -> None:
    rng = np.random.default_rng(0)
    picture = rng.random((60, SIDE, 3)).astype(np.float32)
    responses = picture_edges._responses(picture, 2)
    np.testing.assert_allclose(responses.mean(axis=(1, 2)), 0.0, atol=1e-4)
    np.testing.assert_allclose(responses.std(axis=(1, 2)), 1.0, rtol=1e-3)
    places = rng.normal(size=(2, 30, 2)).astype(np.float32)
    directions = rng.uniform(-np.pi, np.pi, (2, 30)).astype(np.float32)
    radii = np.array(CONFIG.edges.radii[:3], dtype=np.float32)
    jobs = np.array([(0, 0, 0), (1, 7, 1), (0, 23, 2)] * 5)
    scores, found = np.empty(15, np.float32), np.empty((15, 2), np.int64)
    maps = folded(responses)
    shape = np.array([60, SIDE])
    score_views(maps, places, directions, jobs, radii, shape, scores, found)
    assert (scores[12:] == scores[:3]).all()
    scores *= np.abs(responses).max() / np.abs(maps).max()
    for job, (view, roll, size) in enumerate(jobs[:3]):
        asked = (places[view], directions[view])
        angle = 2.0 * np.pi * roll / ROLLS
        best, seen = score(responses, *asked, found[job], angle, radii[size], BINS)
        assert scores[job] == pytest.approx(best, abs=0.02)
        assert seen >= 0.35 * 30
        for _ in range(200):  # nowhere is better
            place = STEP * rng.integers(-24 // STEP, 120 // STEP, 2)
            other, seen = score(responses, *asked, place, angle, radii[size], BINS)
            assert seen < 0.35 * 30 or other <= best + 0.02
    whole = np.pad(responses, [(0, 0), (PAD, PAD), (PAD, PAD)])
    starts = np.array([[0.1, 20.0, 40.0, 30.0]])
    pose, gain = np.empty((1, 5)), score(responses, places[1], directions[1], np.array([40, 30]), 0.1, 20.0, BINS)[0]
    for steps in (0, 1, 2):
        look_again(whole, shape, places, directions, np.array([1]), starts, steps, pose)
        turn, size, *place, fine = pose[0]
        again, _ = score(responses, places[1], directions[1], np.array(place, int), turn, size, BINS)
        assert fine == pytest.approx(again, rel=1e-3)
        assert fine >= gain - 1e-3, "more steps find no less"
        gain = fine
        assert np.abs(place - starts[0, 2:]).max() <= 2.0
        assert abs(turn - 0.1) < np.radians(3.76) * steps + 1e-9
        assert abs(size / 20.0 - 1.0) < 0.056 * steps + 1e-9
    places[0, ::2] *= 0.01
    starts[0, 1:] = 300.0, 40.0, 30.0  # the others lie beyond what is kept around the picture
    look_again(whole, shape, places, directions, np.array([0]), starts, 2, pose)
    turn, size, *place, fine = pose[0]
    again, _ = score(responses, places[0], directions[0], np.array(place, int), turn, size, BINS)
    assert fine == pytest.approx(again, rel=1e-3)


def test_sums_hold_whatever_a_picture_says() -> None:
    """All points of a view on the one edge of an empty picture: a sum that is not beyond 16 bits."""
    responses = np.full((BINS, 60, SIDE), -0.01, np.float32)
    responses[:, 28, 48] = 80.0
    count = CONFIG.edges.points
    points = np.zeros((1, count, 2), np.float32), np.zeros((1, count), np.float32)
    scores, found = np.empty(1, np.float32), np.empty((1, 2), np.int64)
    job, radius, shape = np.zeros((1, 3), np.int64), np.array([12.0], np.float32), np.array([60, SIDE])
    score_views(folded(responses), *points, job, radius, shape, scores, found)
    assert found[0].tolist() == [48, 28]
    assert scores[0] == pytest.approx(32_000.0 / np.sqrt(count), rel=0.01)


@pytest.mark.parametrize("roll", [0.0, 130.0])
def test_the_view_is_found_over_white(plant: GaussianModel, roll: float) -> None:
    """The camera stands between those of the views and is turned; none of its edges against the white is in theirs."""
    rig = make_rig(plant, 24, 640, 480)
    true = rolled(make_rig(plant, 1, 640, 480, jitter=np.array([[0.3, 0.6, 0.4, 0.5]]))[0], np.radians(roll))
    image, alpha, _ = render_depth(plant, true)
    picture = np.clip(image + 1.0 - alpha[..., None], 0.0, 1.0)
    found = search_views(FarViews(plant, rig).views, PictureEdges.of(picture), 5)
    true = true.with_side(SIDE)
    points = plant.means[plant.opacities > 0.9][:500].astype(np.float64)
    errors = [np.median(np.linalg.norm(project(points, camera) - project(points, true), axis=1)) for _, camera in found]
    assert min(errors) < 0.06 * SIDE
    assert [score for score, _ in found] == sorted((score for score, _ in found), reverse=True)
    assert all((camera.width, camera.height) == (96, 72) for _, camera in found)


def test_nothing_to_see_is_no_view(plant: GaussianModel) -> None:
    away = [rolled(camera, 0.0) for camera in make_rig(plant.with_(means=plant.means + 1000.0), 2, 64, 48)]
    assert FarViews(plant, away).views == []
    assert search_views([], PictureEdges.of(np.zeros((48, 64, 3), np.float32)), 3) == []


def test_points_of_a_view_are_the_strongest_that_lie_apart() -> None:
    strength = np.random.default_rng(1).random((20, 30)).astype(np.float32)
    strength[strength < 0.3] = 0.0
    free = np.ones((20, 30), dtype=np.bool_)
    free[:, 15:] = False
    order = np.argsort(-strength.ravel(), kind="stable")
    for count in (7, 500):
        chosen = spread_out(strength, order, count, free.copy(), 2)
        assert [tuple(place) for place in chosen] == strongest_apart(strength, count, free, 2)
    assert 7 < len(chosen) < 500


def test_a_first_glance_spares_most_of_the_search(plant: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """And loses nothing here."""
    picture = PictureEdges.of(np.clip(render_depth(plant, make_rig(plant, 3, 640, 480)[1])[0], 0.0, 1.0))
    views = FarViews(plant, make_rig(plant, 24, 640, 480)).views
    asked: list[tuple[int, int]] = []

    def counted(self: PictureEdges, views: Any, which: Any, starts: Any, steps: int) -> Any:
        asked.append((len(which), steps))
        return placed(self, views, which, starts, steps)

    placed = PictureEdges.placed
    monkeypatch.setattr(PictureEdges, "placed", counted)
    found = search_views(views, picture, 5)
    every = len(views) * ROLLS * len(CONFIG.edges.radii)
    monkeypatch.setattr(view_search, "_CONFIG", replace(CONFIG.edges, promising=every, rescored=every))
    whole = search_views(views, picture, 5)
    assert asked == [(CONFIG.edges.promising, 0), (CONFIG.edges.rescored, 2), (every, 0), (every, 2)]
    assert [score for score, _ in found] == [score for score, _ in whole]
