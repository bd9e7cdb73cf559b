"""Pictures that a moving camera or a lens blurred: their camera is found, and they say nearly what sharp ones do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify import reference_views
from engine.flows.verify.search import Verification, verify_images
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.lab.evaluate.null.null_rates import wrong_key_z
from engine.lab.sim.attacks import image_attack
from engine.model import Camera, Float32, look_at
from engine.pictures.camera import camera_search
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from engine.raster import render, render_depth
from engine.watermark.statistics import z_threshold
from tests.pictures.plant_views import jpeg, reprojection

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_renders")]


@pytest.fixture(scope="module")
def with_landmarks(scene: MarkedScene) -> OpenedRecord:
    reference = scene.opened.reference
    return replace(scene.opened, landmarks=make_landmarks(reference, make_rig(reference, 16, 640, 480)))


@pytest.fixture(scope="module")
def camera(scene: MarkedScene) -> Camera:
    """A view without key."""
    extent = measure_extent(scene.marked)
    eye = extent.center + 3.0 * extent.radius * np.array([0.8, -0.5, 0.6])
    return look_at(eye, extent.center, (0, -1, 0), 800.0, 800, 600)


@pytest.fixture(scope="module")
def sharp(scene: MarkedScene, camera: Camera) -> Float32:
    return np.clip(render(scene.marked, camera), 0.0, 1.0)


def moved(image: Float32, length: float) -> Float32:
    return to_8_bit(image_attack("motion_blur").apply(image, length, rng=np.random.default_rng(3)))


def defocused(image: Float32, sigma: float) -> Float32:
    return to_8_bit(cv2.GaussianBlur(image, (0, 0), sigma))


@pytest.mark.long
@pytest.mark.parametrize(("blur", "strength", "page"), [(moved, 10.0, 0.0), (moved, 15.0, 1.0), (defocused, 3.0, 1.0)])
def test_a_blurred_picture_claims_by_itself(
    with_landmarks: OpenedRecord,
    scene: MarkedScene,
    sharp: Float32,
    camera: Camera,
    monkeypatch: pytest.MonkeyPatch,
    blur: Callable[[Float32, float], Float32],
    strength: float,
    page: float,
) -> None:
    clear = 1.0 - render_depth(scene.marked, camera)[1][..., None]
    read = verify_images([blur(sharp + page * clear, strength)], with_landmarks)
    assert read.claim.verdict.value == "marked"
    assert read.claim.z > z_threshold(2.0**-128, read.claim.tries)
    assert any(note.startswith("blurred: picture 1") for note in read.claim.notes)
    assert read.cameras[0] is not None
    assert reprojection(with_landmarks.reference, camera, read.cameras[0]) < 0.25
    monkeypatch.setattr(reference_views, "find_blur", lambda *_: None)
    before = verify_images([blur(sharp, strength)], with_landmarks, cameras=[camera])
    assert read.claim.z > 1.5 * before.claim.z


@pytest.mark.long
def test_a_known_camera_reads_no_less_than_a_found_one(
    with_landmarks: OpenedRecord, sharp: Float32, camera: Camera
) -> None:
    picture = moved(sharp, 15.0)
    found = verify_images([picture], with_landmarks).claim
    assert known(picture, with_landmarks, camera).claim.z > 0.97 * found.z


def known(picture: Float32, opened: OpenedRecord, camera: Camera) -> Verification:
    return verify_images([picture], opened, cameras=[camera])


def test_what_is_not_blurred_is_read_as_before(
    scene: MarkedScene, sharp: Float32, camera: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = [to_8_bit(sharp), jpeg(sharp, 10)]
    now = [known(picture, scene.opened, camera) for picture in pictures]
    monkeypatch.setattr(reference_views, "find_blur", lambda *_: None)
    for picture, one in zip(pictures, now, strict=True):
        assert one.evidence.y.tobytes() == known(picture, scene.opened, camera).evidence.y.tobytes()
        assert one.claim.notes == ()


@pytest.mark.parametrize("cameras", ["known", pytest.param("found", marks=pytest.mark.long)])
def test_a_blurred_jpeg_is_read_through_its_coder_and_its_blur(
    with_landmarks: OpenedRecord, sharp: Float32, camera: Camera, monkeypatch: pytest.MonkeyPatch, cameras: str
) -> None:
    picture, views = jpeg(defocused(sharp, 3.0), 75), [camera] if cameras == "known" else None
    read = verify_images([picture], with_landmarks, cameras=views).claim
    assert read.z > 0.9 * known(picture, with_landmarks, camera).claim.z
    monkeypatch.setattr(reference_views, "find_blur", lambda *_: None)
    assert read.z > 1.5 * known(picture, with_landmarks, camera).claim.z


def test_a_blurred_picture_of_the_original_makes_no_claim(scene: MarkedScene, camera: Camera) -> None:
    picture = moved(np.clip(render(scene.original, camera), 0.0, 1.0), 12.0)
    claim = known(picture, scene.opened, camera).claim
    assert any(note.startswith("blurred") for note in claim.notes)
    assert claim.verdict.value != "marked"
    assert abs(claim.z) < 5.0


def test_wrong_keys_stay_below_the_bound(scene: MarkedScene, sharp: Float32, camera: Camera) -> None:
    evidence = known(moved(sharp, 15.0), scene.opened, camera).evidence
    keys = 2_000
    z = wrong_key_z(evidence.y, evidence.weights, bytes(range(32)), keys)
    for exponent in (1.0, 1.5, 2.0):
        bound = 10.0**-exponent
        assert (z >= z_threshold(bound)).sum() <= bound * keys + 5 * np.sqrt(bound * keys)
    assert z.std() == pytest.approx(1.0, abs=0.1)
    assert z.max() < z_threshold(1e-9, keys)


@pytest.mark.long
def test_an_enlarged_screenshot_is_read_with_the_low_pass_it_was_drawn_with(
    with_landmarks: OpenedRecord, sharp: Float32, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = to_8_bit(cv2.resize(sharp[100:500, 100:700], None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC))
    read = verify_images([picture], with_landmarks).claim
    monkeypatch.setattr(camera_search, "_with_own_low_pass", lambda *given: (given[1], given[4]))
    assert read.z > 1.15 * verify_images([picture], with_landmarks).claim.z > 10.0
