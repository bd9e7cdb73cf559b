from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.catalogue import entry as entries
from engine.catalogue.config import CONFIG
from engine.catalogue.entry import Entry, see_points
from engine.errors import FormatError
from engine.flows.views.camera_rig import make_rig
from engine.numerics.similarity import transform_model
from engine.pictures.camera.camera_motion import project
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.registration.sketch import make_sketch
from tests.registration.registration_cases import scene as clusters


@pytest.fixture(scope="module")
def entry() -> Entry:
    model = clusters(0, 400)
    rng = np.random.default_rng(0)
    points, views = rng.uniform(-0.2, 0.2, (300, 3)).astype(np.float32), np.repeat(np.arange(3), 100).astype(np.int32)
    landmarks = Landmarks(points, rng.integers(0, 256, (300, 128), np.uint8), views)
    return Entry(make_sketch(model), see_points(landmarks, make_rig(model, 3, 640, 480)))


def test_the_strongest_of_each_view_are_kept_where_it_showed_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entries, "CONFIG", replace(CONFIG, points=120))
    model = clusters(0, 400)
    cameras = make_rig(model, 2, 640, 480)
    points = model.means[:200]
    views = np.repeat([0, 1], 100).astype(np.int32)
    landmarks = Landmarks(points, np.random.default_rng(0).integers(0, 256, (200, 128), np.uint8), views)
    seen = see_points(landmarks, cameras)
    kept = np.concatenate([np.arange(60), 100 + np.arange(60)])
    np.testing.assert_array_equal(seen.descriptors, landmarks.descriptors[kept])
    for view, camera in enumerate(cameras):
        mine = seen.views == view
        np.testing.assert_allclose(seen.places[mine], project(points[kept[mine]].astype(float), camera), atol=1e-3)


@pytest.mark.parametrize("scale", [1.0, 0.001])
def test_what_other_views_show_is_kept_before_what_is_strong(monkeypatch: pytest.MonkeyPatch, scale: float) -> None:
    """At the same place and looking alike; in three views before in two; a heap seen by one view counts for nothing."""
    narrow = replace(CONFIG, points=12, neighbors=120)  # that places decide, not how many lie near
    monkeypatch.setattr(entries, "CONFIG", narrow)
    model = clusters(0, 400)
    cameras = make_rig(transform_model(model, scale, np.eye(3), np.zeros(3)), 3, 640, 480)
    rng = np.random.default_rng(1)
    points = (scale * rng.uniform(-2.0, 2.0, (3, 40, 3))).astype(np.float32)
    descriptors = rng.integers(0, 256, (3, 40, 128), np.uint8)
    points[1, 30:34], descriptors[1, 30:34] = points[0, 30:34], descriptors[0, 30:34]  # in two views
    points[2, 32:34], descriptors[2, 32:34] = points[0, 32:34], descriptors[0, 32:34]  # two of them in all three
    points[1, 35], descriptors[1, 35] = points[0, 35], 255 - descriptors[0, 35]  # the place alone
    descriptors[2, 36] = descriptors[0, 36]  # the look alone
    points[0, 37:40], descriptors[0, 37:40] = points[0, 37], descriptors[0, 37]  # a heap in one view
    flat = Landmarks(points.reshape(-1, 3), descriptors.reshape(-1, 128), np.repeat(np.arange(3), 40).astype(np.int32))
    seen = see_points(flat, cameras)
    kept = [
        np.flatnonzero((descriptors[view] == seen.descriptors[4 * view + k]).all(1))[0]
        for view in range(3)
        for k in range(4)
    ]
    assert kept == [30, 31, 32, 33, 30, 31, 32, 33, 0, 1, 32, 33]


def test_nothing_seen_is_no_points() -> None:
    nothing = Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.int32))
    assert len(see_points(nothing, make_rig(clusters(0, 400), 3, 640, 480))) == 0
    assert len(see_points(nothing, [])) == 0


def test_bytes_and_back(entry: Entry) -> None:
    again = Entry.from_bytes(entry.to_bytes())
    assert entry.seen is not None
    assert again.seen is not None
    np.testing.assert_allclose(again.sketch.looks, entry.sketch.looks, atol=0.01)
    np.testing.assert_array_equal(again.seen.descriptors, entry.seen.descriptors)
    np.testing.assert_allclose(again.seen.places, entry.seen.places.clip(0), atol=1 / 32)
    bare = Entry.from_bytes(Entry(entry.sketch, None).to_bytes())
    assert bare.seen is None
    assert Entry.from_bytes(entry.sketch.to_bytes()).seen is None, "as entries were before pictures were indexed"


@pytest.mark.parametrize("cut", [0, 3, 15, 40, -1, -132])
def test_what_is_no_entry_is_refused(entry: Entry, cut: int) -> None:
    with pytest.raises(FormatError):
        Entry.from_bytes(entry.to_bytes()[:cut])


def test_counts_that_lie_are_refused(entry: Entry) -> None:
    data = bytearray(entry.to_bytes())
    data[8:16] = b"\xff" * 8
    with pytest.raises(FormatError):
        Entry.from_bytes(bytes(data))
