"""Viewers that apply a tone curve to every Gaussian are read by renders that went through the same curve."""

from __future__ import annotations

import numpy as np
import pytest

from engine.flows.verify import reference_views, suspect_evidence
from engine.flows.verify.reference_views import ReferenceViews
from engine.flows.verify.search import verify_images
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.display_view import with_all
from engine.formats import read_model
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.lab.sim.attacks import image_attack, model_attack
from engine.model import Camera, Float32
from engine.pictures.alignment.tone_and_light import TONES, ViewerTone, find_viewer_tone
from engine.pictures.camera.camera_search import FoundCamera
from engine.pictures.camera.pose_refinement import DEFAULT_SETTINGS
from engine.raster import draw, prepare_view, render, sh_colors
from tests.flows.conftest import SCENE

BY_NAME = {tone.name: tone for tone in TONES}


@pytest.fixture(scope="module")
def camera(scene: MarkedScene) -> Camera:
    return make_rig(scene.original, 6, 400, 400, jitter=np.random.default_rng(0).random((6, 4)))[0]


def jpeg(image: Float32) -> Float32:
    return to_8_bit(image_attack("jpeg").apply(to_8_bit(image), 80, rng=np.random.default_rng(1)))


def through(scene: MarkedScene, camera: Camera, tone: ViewerTone) -> Float32:
    """As a viewer shows the marked model that applies a curve to every Gaussian."""
    colors = tone(sh_colors(scene.marked.sh, scene.marked.means, camera.position))
    return np.clip(prepare_view(scene.marked, camera).render(colors)[0], 0.0, 1.0)


def tone_of(scene: MarkedScene, camera: Camera, picture: Float32) -> str | None:
    found = ReferenceViews(scene.opened).tone(camera, DEFAULT_SETTINGS, picture)
    return None if found is None else found.name


def z(scene: MarkedScene, camera: Camera, picture: Float32, monkeypatch: pytest.MonkeyPatch) -> float:
    found = FoundCamera(camera, 100, 0.01, 0.99, 0.0, 1.0, 0.99)
    monkeypatch.setattr(suspect_evidence, "_find", lambda *_: found)
    return verify_images([picture], scene.opened).claim.z


@pytest.mark.parametrize("name", BY_NAME)
def test_a_curve_of_every_gaussian_is_recognized(scene: MarkedScene, camera: Camera, name: str) -> None:
    assert tone_of(scene, camera, jpeg(through(scene, camera, BY_NAME[name]))) == name


def test_no_curve_is_seen_where_there_is_none(scene: MarkedScene, camera: Camera) -> None:
    plain = np.clip(render(scene.marked, camera), 0.0, 1.0)
    blended = BY_NAME["aces"](plain.reshape(-1, 3)).reshape(plain.shape)
    assert np.abs(blended - through(scene, camera, BY_NAME["aces"])).max() > 0.02, "else both are one picture"
    for picture in (plain, blended, plain**0.7, 0.8 * plain + 0.1, np.clip(1.3 * plain, 0.0, 1.0)):
        assert tone_of(scene, camera, jpeg(picture)) is None
    assert tone_of(scene, camera, np.zeros_like(plain)) is None


def test_a_small_view_does_not_decide() -> None:
    """Of a merged model it shows thin Gaussians wider than the picture does, and a curve where there is none."""
    model = model_attack("merge").apply(read_model(SCENE).model, 0.132)
    camera = with_all(model, make_rig(model, 24, 1200, 900)[10])
    picture = np.clip(render(model, camera), 0.0, 1.0)
    assert find_viewer_tone(model, camera.with_side(256), DEFAULT_SETTINGS, picture) is not None
    assert find_viewer_tone(model, camera, DEFAULT_SETTINGS, picture) is None
    toned = BY_NAME["aces2"](sh_colors(model.sh, model.means, camera.position))
    picture = np.clip(prepare_view(model, camera).render(toned)[0], 0.0, 1.0)
    assert find_viewer_tone(model, camera, DEFAULT_SETTINGS, picture) is BY_NAME["aces2"]


@pytest.mark.parametrize("name", ["aces", pytest.param("neutral", marks=pytest.mark.long)])
def test_it_reads_more_than_a_curve_of_the_blended_picture(
    scene: MarkedScene, camera: Camera, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = jpeg(through(scene, camera, BY_NAME[name]))
    with_curve = z(scene, camera, picture, monkeypatch)
    monkeypatch.setattr(reference_views, "find_viewer_tone", lambda *_: None)
    assert with_curve > 1.05 * z(scene, camera, picture, monkeypatch)


def test_slopes_are_those_of_the_curve(scene: MarkedScene, camera: Camera) -> None:
    """What a picture answers to a small change of one Gaussian's color, by differences of renders."""
    reference = ReferenceViews(scene.opened).at(camera, DEFAULT_SETTINGS, BY_NAME["aces"])
    colors = draw(scene.opened.reference, camera).colors
    seen = reference.view.visible[:50]
    changed = colors.copy()
    changed[seen] += np.float32(0.01)
    before, after = (BY_NAME["aces"](each) for each in (colors, changed))
    assert reference.steep is not None
    np.testing.assert_allclose((after - before)[seen] / 0.01, reference.steep[seen], rtol=0.15, atol=0.02)
