"""A screenshot of a stolen model that was bent: read part by part."""

from __future__ import annotations

import numpy as np
import pytest

from engine.flows.verify import suspect_evidence as picture_reading
from engine.flows.verify import suspect_evidence as reading
from engine.flows.verify.search import Verification, verify_images
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.lab.sim.attacks import image_attack
from engine.lab.sim.physics.deformations import bend
from engine.model import Camera, Float32, GaussianModel
from engine.pictures.alignment.local_flow import LocalAlignment
from engine.pictures.camera.camera_search import FoundCamera
from engine.raster import render, render_depth

SIDE = 256
LEAST = 15.0, 9.0
"""Z of it before black and before grey; read by its camera alone it came to 7.8 and 6.8."""


@pytest.fixture(scope="module")
def scene(whole_scene: MarkedScene) -> MarkedScene:
    return whole_scene


@pytest.fixture
def camera(scene: MarkedScene, monkeypatch: pytest.MonkeyPatch) -> Camera:
    camera = make_rig(scene.original, 6, SIDE, SIDE, jitter=np.random.default_rng(0).random((6, 4)))[0]
    found = FoundCamera(camera, 0, 0.01, 0.99, 0.001)
    monkeypatch.setattr(reading, "_find", lambda *_: found)
    return camera


def shot(model: GaussianModel, camera: Camera, behind: float = 0.0) -> Float32:
    image, alpha, _ = render_depth(model, camera)
    over = to_8_bit(image + behind * (1.0 - alpha[..., None]))
    return to_8_bit(image_attack("jpeg").apply(over, 80, rng=np.random.default_rng(0)))


def read(scene: MarkedScene, picture: Float32) -> Verification:
    return verify_images([picture], scene.opened)


@pytest.mark.parametrize(("behind", "least"), [pytest.param(0.0, LEAST[0], marks=pytest.mark.long), (0.7, LEAST[1])])
def test_a_bent_model_is_read_part_by_part(scene: MarkedScene, camera: Camera, behind: float, least: float) -> None:
    assert read(scene, shot(bend(scene.marked, 8.0), camera, behind)).claim.z > least


def test_the_bent_original_stays_unmarked(scene: MarkedScene, camera: Camera) -> None:
    assert abs(read(scene, shot(bend(scene.original, 8.0), camera)).claim.z) < 4.0


def test_the_way_that_promises_less_is_not_taken(
    scene: MarkedScene, camera: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of what fits as it is, the upper half says less than all."""
    picture = to_8_bit(render(scene.marked, camera))
    said = read(scene, picture).evidence
    corner = np.zeros((SIDE, SIDE), dtype=bool)
    corner[: SIDE // 2] = True
    monkeypatch.setattr(
        picture_reading,
        "align_locally",
        lambda _, __, image: LocalAlignment(image, corner, np.zeros((SIDE, SIDE, 2), np.float32)),
    )
    assert said.y.tobytes() == read(scene, picture).evidence.y.tobytes()


def test_what_is_not_bent_is_read_as_ever(scene: MarkedScene, camera: Camera, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = to_8_bit(render(scene.marked, camera))
    said = read(scene, picture).evidence
    monkeypatch.setattr(picture_reading, "align_locally", lambda *_: None)
    assert said.y.tobytes() == read(scene, picture).evidence.y.tobytes()
