"""What a JPEG coder stored is read in the picture's own pixels, wherever its blocks begin."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.flows.verify.config import CONFIG
from engine.flows.verify.search import verify_images
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.lab.sim.attacks import image_attack
from engine.model import Camera, Float32
from engine.pictures.jpeg.coded_blocks import agreement
from engine.pictures.jpeg.config import CONFIG as JPEG
from engine.raster import RasterSettings, render
from engine.watermark.claim import Claim

SIDE = 400


@pytest.fixture(scope="module")
def camera(scene: MarkedScene) -> Camera:
    return make_rig(scene.original, 6, SIDE, SIDE, jitter=np.random.default_rng(0).random((6, 4)))[0]


def attacked(image: Float32, *steps: tuple[str, float]) -> Float32:
    for name, strength in steps:
        image = to_8_bit(image_attack(name).apply(image, strength, rng=np.random.default_rng(1)))
    return image


def claim_of(scene: MarkedScene, camera: Camera, image: Float32) -> Claim:
    return verify_images([image], scene.opened, cameras=[camera]).claim


def z(scene: MarkedScene, camera: Camera, image: Float32) -> float:
    return claim_of(scene, camera, image).z


@pytest.mark.parametrize("kind", ["cut after, mirrored", pytest.param("turned before", marks=pytest.mark.long)])
def test_blocks_are_read_in_the_pictures_own_pixels(
    scene: MarkedScene, camera: Camera, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shot = to_8_bit(render(scene.marked, camera))
    if kind == "turned before":
        picture = attacked(shot, ("rotate_image", 20.0), ("jpeg", 10))
    else:
        picture = np.ascontiguousarray(attacked(shot, ("jpeg", 10))[29:349, 45:365][:, ::-1])
    own = z(scene, camera, picture)
    if kind == "turned before":  # bilinear: softer than a render
        monkeypatch.setattr("engine.flows.verify.suspect_evidence._CONFIG", replace(CONFIG.evidence, soft=()))
        assert own > 1.05 * z(scene, camera, picture)
    for module in ("engine.flows.verify.suspect_evidence", "engine.watermark.image_evidence"):
        monkeypatch.setattr(f"{module}.find_grid", lambda _: None)
    assert own > 1.15 * z(scene, camera, picture)


def test_a_jpeg_of_another_renderer_is_read_by_what_its_errors_leave(
    scene: MarkedScene, camera: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The coder's score takes the other renderer's errors for the mark's; of our own renders it stays."""
    antialiased = to_8_bit(render(scene.marked, camera, settings=RasterSettings(antialiased=True)))
    foreign, own = attacked(antialiased, ("jpeg", 80)), attacked(to_8_bit(render(scene.marked, camera)), ("jpeg", 50))
    read = [z(scene, camera, each) for each in (foreign, own)]
    monkeypatch.setattr("engine.watermark.image_evidence.JPEG", replace(JPEG, own_agreement=0.0))
    scored = [z(scene, camera, each) for each in (foreign, own)]
    assert read[0] > 1.2 * scored[0]
    assert read[1] == scored[1]


def test_chroma_of_another_renderers_jpeg_is_read_by_its_intervals(
    scene: MarkedScene, camera: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    antialiased = to_8_bit(render(scene.marked, camera, settings=RasterSettings(antialiased=True)))
    coded = attacked(antialiased, ("jpeg", 80))
    read = z(scene, camera, coded)
    monkeypatch.setattr("engine.watermark.image_evidence.CodedChroma.of", lambda *_: None)
    assert read > 1.03 * z(scene, camera, coded) > 5.0


def test_a_jpeg_of_another_renderer_is_not_carried(
    scene: MarkedScene, camera: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its multiples are not those of the reference, wherever it lies: the places are not all tried."""
    tried: list[float] = []

    def counted(*what: Any) -> float:
        tried.append(agreement(*what))
        return tried[-1]

    monkeypatch.setattr("engine.flows.verify.suspect_evidence.agreement", counted)
    antialiased = to_8_bit(render(scene.marked, camera, settings=RasterSettings(antialiased=True)))
    for shot, all_places in ((antialiased, False), (to_8_bit(render(scene.marked, camera)), True)):
        tried.clear()
        assert z(scene, camera, attacked(shot, ("jpeg", 90))[29:349, 45:365]) > 5.0
        assert (max(tried) > CONFIG.evidence.coded_alike) == all_places
        assert (len(tried) > CONFIG.evidence.carried) == all_places


@pytest.mark.parametrize("quality", [10, 80])
def test_what_a_scored_picture_would_show_is_predicted(scene: MarkedScene, camera: Camera, quality: int) -> None:
    claim = claim_of(scene, camera, attacked(to_8_bit(render(scene.marked, camera)), ("jpeg", quality)))
    assert 0.4 * claim.z < claim.expected_z < 1.6 * claim.z


def test_a_render_shows_what_was_predicted_of_it(scene: MarkedScene) -> None:
    cameras = make_rig(scene.original, 6, 800, 800, jitter=np.random.default_rng(0).random((6, 4)))[:3]
    read = [z(scene, each, attacked(render(scene.marked, each), ("jpeg", 10))) for each in cameras]
    assert np.median(read) == pytest.approx(scene.report["predicted_z_render"], rel=0.3)
