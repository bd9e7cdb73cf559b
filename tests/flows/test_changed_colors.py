"""A model whose colors were averaged over neighbors, to wash the mark out: its pictures and renders still claim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.flows.progress import Clock
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify import reference_views
from engine.flows.verify.reference_views import ReferenceViews
from engine.flows.verify.search import Verification, verify_images
from engine.flows.verify.suspect_evidence import Seen, read_renders
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.bench.removal import wash
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.lab.evaluate.null.null_rates import wrong_key_z
from engine.lab.sim.adversaries.laundering import rattle, smooth
from engine.model import Camera, Float32, GaussianModel
from engine.pictures.alignment.blur import Blur
from engine.pictures.alignment.color_change import ColorSmoothing, Neighborhoods
from engine.pictures.alignment.tone_and_light import TONES
from engine.raster import draw, render, sh_colors
from engine.registration.registration_search import Registration
from engine.watermark.layers import layered_z
from engine.watermark.statistics import z_threshold
from tests.pictures.plant_views import jpeg

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_renders")]


@pytest.fixture(scope="module")
def cameras(scene: MarkedScene) -> list[Camera]:
    """Views without key."""
    return make_rig(scene.original, 3, 480, 480)


def pictures(model: GaussianModel, cameras: list[Camera]) -> list[Float32]:
    return [to_8_bit(render(model, camera)) for camera in cameras]


def known(model: GaussianModel, scene: MarkedScene, cameras: list[Camera]) -> Verification:
    return verify_images(pictures(model, cameras), scene.opened, cameras=cameras)


def test_pictures_of_a_washed_model_claim(
    scene: MarkedScene, cameras: list[Camera], monkeypatch: pytest.MonkeyPatch
) -> None:
    washed = smooth(scene.marked, 32)
    read = known(washed, scene, cameras)
    assert read.claim.verdict.value == "marked"
    assert sum("averaged over neighbors" in note for note in read.claim.notes) == len(cameras)
    z = wrong_key_z(read.evidence.y, read.evidence.weights, bytes(range(32)), 2_000)
    assert z.mean() == pytest.approx(0.0, abs=0.1)
    assert z.std() == pytest.approx(1.0, abs=0.1)
    assert z.max() < z_threshold(1e-9, 2_000)
    monkeypatch.setattr(reference_views, "find_color_change", lambda *_: None)
    assert read.claim.z > 1.5 * known(washed, scene, cameras).claim.z


def test_washing_is_not_looked_for_through_a_viewers_tone_curve(scene: MarkedScene, cameras: list[Camera]) -> None:
    """The renders by which it is recognized have no curve."""
    reference, camera = ReferenceViews(scene.opened), cameras[0]
    washed = smooth(scene.marked, 32)
    picture, everywhere = to_8_bit(render(washed, camera)), np.ones((480, 480), dtype=bool)
    assert reference.changed_as(reference.at(camera), picture, everywhere) is not None
    toned = reference.at(camera, tone=TONES[0])
    seen = TONES[0](sh_colors(washed.sh, washed.means, camera.position))
    picture = to_8_bit(draw(washed, camera, colors=seen).image)
    assert reference.changed_as(toned, picture, everywhere) is None


def test_washing_is_looked_for_once_in_sharp_pictures_of_marks_in_plain_colors(
    scene: MarkedScene, cameras: list[Camera]
) -> None:
    """Else a second washing would be fitted to what the first one left, or to a blur; and all harmonics are not DC."""
    reference, camera, everywhere = ReferenceViews(scene.opened), cameras[0], np.ones((480, 480), dtype=bool)
    picture = to_8_bit(render(smooth(scene.marked, 32), camera))
    assert reference.changed_as(reference.at(camera), picture, everywhere) is not None
    little = ColorSmoothing(Neighborhoods(scene.opened.reference.means), np.array([0.9, 0.1, 0.0, 0.0]))
    changed = ReferenceViews(scene.opened, little)
    assert changed.changed_as(changed.at(camera), picture, everywhere) is None
    blur = Blur(np.full((5, 5), 1 / 25, dtype=np.float32))
    assert reference.changed_as(replace(reference.at(camera), blur=blur), picture, everywhere) is None
    layout = scene.opened.layout
    wide = replace(layout, directions=tuple(np.pad(each, ((0, 0), (0, 45))) for each in layout.directions))
    whole = ReferenceViews(replace(scene.opened, layout=wide))
    assert whole.changed_as(reference.at(camera), picture, everywhere) is None


def test_washing_is_looked_for_where_the_model_alone_is_seen(scene: MarkedScene, cameras: list[Camera]) -> None:
    """Neither what covers a part of the picture nor what shines through the model's edges has a say."""
    reference, camera, mask = ReferenceViews(scene.opened), cameras[0], np.ones((480, 480), dtype=bool)
    view, picture = reference.at(camera), to_8_bit(render(smooth(scene.marked, 32), camera))
    plain = reference.changed_as(view, picture, mask)
    assert plain is not None
    assert plain.change is not None
    noise = np.random.default_rng(6).random(picture.shape, dtype=np.float32)
    behind = np.clip(picture + (1.0 - view.alpha[..., None]) * noise, 0.0, 1.0)
    found = reference.changed_as(view, behind, mask)
    assert found is not None
    assert found.change is not None
    assert found.change.kept == pytest.approx(plain.change.kept, abs=0.02)
    covered, mask[:, 200:240] = picture.copy(), False
    covered[:, 200:240] = noise[:, 200:240]
    found = reference.changed_as(view, covered, mask)
    assert found is not None
    assert found.change is not None
    assert found.change.kept == pytest.approx(plain.change.kept, abs=0.1)
    mask[:] = True
    assert reference.changed_as(view, covered, mask) is None


@pytest.mark.long
def test_pictures_of_a_denoised_model_claim(
    scene: MarkedScene, cameras: list[Camera], monkeypatch: pytest.MonkeyPatch
) -> None:
    layout = scene.opened.layout
    denoised = wash(scene.marked, 8.0, float(np.sqrt(np.square(layout.displace(layout.amplitudes)).mean())))
    read = known(denoised, scene, cameras)
    assert sum("denoised" in note for note in read.claim.notes) == len(cameras)
    z = wrong_key_z(read.evidence.y, read.evidence.weights, bytes(range(32)), 2_000)
    assert z.std() == pytest.approx(1.0, abs=0.1)
    assert z.max() < z_threshold(1e-9, 2_000)
    monkeypatch.setattr(reference_views, "find_color_change", lambda *_: None)
    assert read.claim.z > 1.2 * known(denoised, scene, cameras).claim.z


def test_a_washed_original_makes_no_claim(scene: MarkedScene, cameras: list[Camera]) -> None:
    claim = known(smooth(scene.original, 32), scene, cameras).claim
    assert any("averaged over neighbors" in note for note in claim.notes)
    assert claim.verdict.value != "marked"
    assert abs(claim.z) < 5.0


def test_what_was_not_smoothed_is_read_as_before(
    scene: MarkedScene, cameras: list[Camera], monkeypatch: pytest.MonkeyPatch
) -> None:
    camera, sharp = cameras[0], pictures(scene.marked, cameras)[0]
    seen = [sharp, jpeg(sharp, 50), jpeg(sharp, 10)]
    now = [verify_images([one], scene.opened, cameras=[camera]) for one in seen]
    monkeypatch.setattr(reference_views, "find_color_change", lambda *_: None)
    for picture, one in zip(seen, now, strict=True):
        before = verify_images([picture], scene.opened, cameras=[camera])
        assert one.evidence.y.tobytes() == before.evidence.y.tobytes()
        assert one.claim.notes == ()


def unregistered(suspect: GaussianModel) -> Registration:
    nothing = np.full(len(suspect), -1, dtype=np.int32)
    return Registration(1.0, np.eye(3), np.zeros(3), nothing, np.zeros(len(suspect), np.float32), 0.0, False, 1)


def tint_z(seen: Seen, opened: OpenedRecord) -> float:
    spreading = opened.spreading_of(len(seen.evidence.y))
    evidence = seen.evidence.sized(spreading.sizes)
    return layered_z(evidence, spreading.signs(opened.message), opened.layout.chips).z["tint"]


@pytest.mark.long
def test_a_model_drawn_anew_in_its_place_is_told_and_read(scene: MarkedScene, monkeypatch: pytest.MonkeyPatch) -> None:
    """As purification leaves it: not one Gaussian where it was, the look smoothed."""
    suspect = rattle(smooth(scene.marked, 32), 0.1, np.random.default_rng(0))
    seen = read_renders(suspect, scene.opened, unregistered(suspect), Clock(None))
    assert seen.recognised
    assert any("trained or drawn anew" in note for note in seen.notes)
    assert any("averaged over neighbors" in note for note in seen.notes)
    monkeypatch.setattr(reference_views, "find_color_change", lambda *_: None)
    plain = read_renders(suspect, scene.opened, unregistered(suspect), Clock(None))
    assert tint_z(seen, scene.opened) > 1.5 * tint_z(plain, scene.opened)


def test_another_model_in_its_place_is_not_recognised(scene: MarkedScene) -> None:
    turned = scene.marked.with_(means=scene.marked.means[:, [1, 2, 0]])
    seen = read_renders(turned, scene.opened, unregistered(turned), Clock(None))
    assert not seen.recognised
