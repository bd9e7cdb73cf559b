"""Frames of a video: only the first, and what comes after a cut, takes the whole search for a camera."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from engine.flows.progress import Clock
from engine.flows.verify import suspect_evidence as reading
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.model import Camera, Float32
from engine.pictures.camera.camera_search import FoundCamera, find_camera
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from engine.raster import render
from tests.pictures.plant_views import around, jpeg, reprojection


def test_frames_follow_each_other_until_a_cut(scene: MarkedScene, monkeypatch: pytest.MonkeyPatch) -> None:
    model = scene.original
    cameras = [around(model, azimuth, 25.0, 1.4, 1.2) for azimuth in (100.0, 101.0, 102.5, 250.0, 251.0)]
    bank = make_landmarks(model, [around(model, azimuth, 20.0, 1.3, 1.1) for azimuth in (85.0, 115.0, 240.0, 270.0)])
    searched: list[Float32] = []
    seen: list[Camera] = []

    def search(landmarks: Any, reference: Any, image: Float32, **more: Any) -> FoundCamera | None:
        searched.append(image)
        return find_camera(landmarks, reference, image)

    monkeypatch.setattr(reading, "find_camera", search)
    monkeypatch.setattr(reading, "read_found", lambda _, found, __: seen.append(found.camera))
    shots = [jpeg(render(scene.marked, camera), 80) for camera in cameras]
    reading.read_pictures(shots, replace(scene.opened, landmarks=bank), None, Clock())
    assert [any(image is shot for image in searched) for shot in shots] == [True, False, False, True, False]
    assert len(seen) == len(cameras)
    assert max(reprojection(model, *pair) for pair in zip(cameras, seen, strict=True)) < 0.2
