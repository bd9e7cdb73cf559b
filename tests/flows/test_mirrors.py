"""A mirror image of a marked model, and mirrored pictures of it, say what they would say unmirrored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.lab.sim.attacks import model_attack
from engine.model import GaussianModel, look_at
from engine.numerics.similarity import mirror_model
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from engine.present.numerals import PLAIN
from engine.present.wording import words_of
from engine.raster import render

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_renders")]


@pytest.fixture(scope="module")
def suspect(scene: MarkedScene) -> GaussianModel:
    """Negated in x by hand (the scene has no harmonics), four fifths kept, noised, turned and scaled."""
    rng = np.random.default_rng(0)
    part = scene.marked.take(rng.permutation(len(scene.marked))[: int(0.8 * len(scene.marked))])
    assert part.sh.shape[1] == 1
    negated = part.with_(
        means=part.means * np.float32([-1, 1, 1]) + 0.1 * part.means.std(axis=0) * rng.normal(size=part.means.shape),
        quats=part.quats * np.float32([1, 1, -1, -1]),
        log_scales=part.log_scales + rng.normal(0, 0.05, part.log_scales.shape),
        opacity_logits=part.opacity_logits + rng.normal(0, 0.2, len(part)),
    )
    return model_attack("similarity").apply(negated, 3.0, rng=1)


@pytest.fixture(scope="module")
def with_landmarks(scene: MarkedScene) -> OpenedRecord:
    reference = scene.opened.reference
    return replace(scene.opened, landmarks=make_landmarks(reference, make_rig(reference, 16, 640, 480)))


@pytest.fixture(scope="module")
def screenshots(scene: MarkedScene) -> list[np.ndarray]:
    extent = measure_extent(scene.marked)
    eyes = (extent.center + 3.0 * extent.radius * np.array(way) for way in ((0.8, -0.5, 0.6), (-0.9, -0.4, 0.5)))
    cameras = [look_at(eye, extent.center, (0, -1, 0), 640.0, 640, 480) for eye in eyes]
    return [to_8_bit(render(scene.marked, camera)) for camera in cameras]


@pytest.mark.long
def test_a_mirrored_model_claims_as_if_it_were_not(scene: MarkedScene, suspect: GaussianModel) -> None:
    mirrored, plain = (verify_model(m, scene.opened).claim for m in (suspect, mirror_model(suspect)))
    assert mirrored.verdict.value == "marked"
    assert mirrored.bit_accuracy == 1.0
    assert mirrored.z == pytest.approx(plain.z, rel=0.05)
    assert mirrored.tries == plain.tries  # a mirror spends none
    assert mirrored.transform is not None
    assert plain.transform is not None
    assert (mirrored.transform.mirrored, plain.transform.mirrored) == (True, False)
    assert "the suspect model is a mirror image of the asset, and was read as such" in mirrored.notes
    assert not any("mirror" in note for note in plain.notes)
    told = [fact.text for fact in words_of(mirrored.to_json() | {"record_id": "", "owner": ""}, PLAIN).facts]
    assert any("mirrored, rotated by" in text for text in told)


def test_its_renders_are_read_in_the_mirror(scene: MarkedScene) -> None:
    suspect = model_attack("similarity").apply(mirror_model(scene.marked), 3.0, rng=1)
    claim = verify_model(suspect, scene.opened, VerifyConfig(route="render")).claim
    assert (claim.verdict.value, claim.bit_accuracy) == ("marked", 1.0)


def test_an_unmarked_mirror_image_makes_no_claim(scene: MarkedScene) -> None:
    claim = verify_model(mirror_model(scene.original), scene.opened).claim
    assert claim.verdict.value != "marked"
    assert claim.derived_fraction == pytest.approx(1.0, abs=0.01)


@pytest.mark.long
@pytest.mark.parametrize("axis", [0, 1])
def test_mirrored_screenshots_claim_as_if_they_were_not(
    with_landmarks: OpenedRecord, screenshots: list[np.ndarray], axis: int
) -> None:
    plain = verify_images(screenshots, with_landmarks).claim
    turned = [np.ascontiguousarray(np.flip(screenshots[0], axis)), screenshots[1]]
    mirrored = verify_images(turned, with_landmarks).claim
    assert plain.verdict.value == mirrored.verdict.value == "marked"
    assert mirrored.z == pytest.approx(plain.z, rel=0.05)
    assert mirrored.tries == plain.tries
    assert plain.notes == ()
    assert mirrored.notes == ("mirrored: picture 1 was turned over before it was read",)
    assert mirrored.derivation.views == (2, 2)


@pytest.mark.parametrize("axis", [0, pytest.param(1, marks=pytest.mark.long)])
def test_a_mirrored_picture_of_a_known_camera_is_turned_over(scene: MarkedScene, axis: int) -> None:
    camera = scene.opened.cameras[1]
    picture = to_8_bit(render(scene.marked, camera))
    plain = verify_images([picture], scene.opened, cameras=[camera]).claim
    mirrored = verify_images([np.flip(picture, axis)], scene.opened, cameras=[camera]).claim
    assert plain.verdict.value == mirrored.verdict.value == "marked"
    assert mirrored.z == pytest.approx(plain.z, rel=0.02)
    assert mirrored.notes == ("mirrored: picture 1 was turned over before it was read",)
