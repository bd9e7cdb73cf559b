"""Cameras of pictures that were cropped, and of such with a page around them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.model import Camera, GaussianModel
from engine.pictures.camera import camera_proposals, camera_search
from engine.pictures.camera.camera_proposals import Candidate
from engine.pictures.camera.camera_search import FoundCamera, find_camera
from engine.pictures.camera.config import CONFIG
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import render
from tests.pictures.plant_views import around, jpeg, reprojection

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("left", "top"), [(0, 120), (130, 0)])
def test_where_the_middle_was_is_found_when_a_part_was_cut_off(
    plant: GaussianModel, bank: Landmarks, left: int, top: int
) -> None:
    whole = around(plant, 48, 33, 1.1, 0.8)
    part = np.clip(render(plant, whole), 0, 1)[top : top + 240, left : left + 350]
    found = find_camera(bank, plant, jpeg(part, 80))
    assert found is not None
    K = whole.K.copy()
    K[:2, 2] -= left, top
    assert reprojection(plant, Camera(whole.viewmat, K, 350, 240), found.camera) < 0.1
    np.testing.assert_allclose(found.camera.K[:2, 2], K[:2, 2], atol=8.0)


@pytest.mark.parametrize("mirrored", [pytest.param(False, marks=pytest.mark.long), True])
def test_what_is_around_a_viewer_does_not_mislead(plant: GaussianModel, bank: Landmarks, mirrored: bool) -> None:
    """A page around a viewer in which the model is larger than fits."""
    true = around(plant, 48, 33, 0.8, 0.9)
    page = np.zeros((560, 700, 3), np.float32)
    page[100:460, 120:600] = np.clip(render(plant, true), 0, 1)
    page = jpeg(page[:, ::-1] if mirrored else page, 80)
    found = find_camera(bank, plant, np.ascontiguousarray(page))
    assert found is not None
    assert found.mirrored is mirrored
    K = true.K.copy()
    K[:2, 2] += 120.0, 100.0
    assert reprojection(plant, Camera(true.viewmat, K, 700, 560), found.of_whole(page)) < 0.3
    assert found.face(page).shape[0] < 400


def test_where_the_part_within_a_frame_is_not_recognised_the_whole_is(
    plant: GaussianModel, bank: Landmarks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame may be wrong, and may leave next to nothing."""
    true = around(plant, 48, 33, 1.1, 0.8)
    for rows in (slice(0, 60), slice(0, 5)):
        monkeypatch.setattr(camera_proposals, "find_frame", lambda *_, rows=rows: (rows, slice(0, 480)))
        found = find_camera(bank, plant, jpeg(render(plant, true), 80))
        assert found is not None
        assert found.frame is None
        assert reprojection(plant, true, found.camera) < 0.1


def test_a_picture_that_is_explained_is_asked_for_neither_frame_nor_shape(
    plant: GaussianModel, bank: Landmarks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both take longer than the search itself."""

    def fail(*_: object) -> None:
        raise AssertionError("asked")

    for name in ("frame", "uneven"):
        monkeypatch.setattr(camera_proposals.Candidates, name, fail)
    found = find_camera(bank, plant, jpeg(render(plant, around(plant, 48, 33, 1.1, 0.8)), 80))
    assert found is not None
    assert found.camera.K[0, 0] == found.camera.K[1, 1]
    np.testing.assert_array_equal(found.camera.K[:2, 2], [240.0, 180.0])


@pytest.mark.parametrize(("small", "asks"), [(0.95, False), (0.92, True)])
def test_what_is_nearly_explained_in_small_is_asked_at_its_own_size_first(
    plant: GaussianModel, bank: Landmarks, monkeypatch: pytest.MonkeyPatch, small: float, asks: bool
) -> None:
    kept, asked = camera_search._best_candidate, []

    def rough(*given: Any) -> Candidate | None:
        best = kept(*given)
        return None if best is None else replace(best, correlation=small, uncovered_correlation=small)

    monkeypatch.setattr(camera_search, "_best_candidate", rough)
    monkeypatch.setattr(camera_proposals.Candidates, "uneven", lambda *_: asked.append(True))
    assert find_camera(bank, plant, jpeg(render(plant, around(plant, 48, 33, 1.1, 0.8)), 80)) is not None
    assert bool(asked) is asks


@pytest.mark.parametrize(
    ("correlation", "gain", "small", "framed"),
    [(0.95, 0.3, 0.94, False), (0.95, 0.3, 0.92, False), (0.95, 9.0, 0.94, True), (0.99995, 0.3, 0.92, True)],
)
def test_a_frame_in_which_less_is_explained_is_none(
    plant: GaussianModel,
    bank: Landmarks,
    monkeypatch: pytest.MonkeyPatch,
    correlation: float,
    gain: float,
    small: float,
    framed: bool,
) -> None:
    """A part of a picture may correlate better than the whole, and yet say less; what it explains fully is believed
    where the whole is not explained even in small."""
    true = around(plant, 48, 33, 1.1, 0.8)
    picture = np.clip(render(plant, true), 0, 1)
    picture[:, 380:] = 0.5  # some of it is hidden: not all is explained
    monkeypatch.setattr(camera_search, "CONFIG", replace(CONFIG, explained_uncovered=0.9999))
    monkeypatch.setattr(camera_proposals, "find_frame", lambda *_: (slice(0, 360), slice(0, 380)))
    kept, asked, trial = camera_search.find_camera, [], camera_search._best_candidate

    def rough(*given: Any) -> Candidate | None:
        best = trial(*given)
        return None if best is None else replace(best, correlation=small, uncovered_correlation=small)

    monkeypatch.setattr(camera_search, "_best_candidate", rough)

    def worse(*given: object, **named: object) -> FoundCamera | None:
        found = kept(*given, **named)  # type: ignore[arg-type]  # as they came
        asked.append(found)
        return (
            None
            if found is None
            else replace(found, correlation=correlation, uncovered_correlation=correlation, gain=gain * found.gain)
        )

    monkeypatch.setattr(camera_search, "find_camera", worse)
    found = kept(bank, plant, jpeg(picture, 80))
    assert asked
    assert found is not None
    assert (found.frame is not None) is framed


def test_what_a_panel_lies_over_is_asked_for_no_frame(
    plant: GaussianModel, bank: Landmarks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All else is explained; the search within a frame takes as long as that of the whole."""
    asked: list[object] = []
    monkeypatch.setattr(camera_proposals.Candidates, "frame", lambda *_: asked.append(True))
    picture = np.clip(render(plant, around(plant, 48, 33, 0.8, 0.8)), 0, 1)
    picture[200:290, 240:310] = 0.1 + 0.1 * picture[200:290, 240:310]
    found = find_camera(bank, plant, picture)
    assert found is not None
    assert found.correlation < CONFIG.explained_uncovered < found.uncovered_correlation
    assert not asked
