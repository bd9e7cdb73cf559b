"""Pictures as a marked scene gives them: both layers are read, in both ways, and every copy finds its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.flows.trace.tracing import trace_images
from engine.flows.verify import reference_views
from engine.flows.verify.reference_views import ReferenceViews
from engine.flows.verify.search import verify_images
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.bench.removal import wash
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.gaussians import flatten
from engine.raster import RasterSettings, render
from engine.watermark.rates import DRAWS
from engine.watermark.statistics import z_threshold

SIDE = 512


@pytest.fixture(scope="module")
def cameras(scene: MarkedScene) -> list[Camera]:
    return seen_from(scene)


def seen_from(scene: MarkedScene) -> list[Camera]:
    jitter = np.random.default_rng(0).random((6, 4))
    return make_rig(scene.original, 6, SIDE, SIDE, jitter=jitter)[::2]


def shots(model: GaussianModel, cameras: list[Camera], drawn: RasterSettings = RasterSettings()) -> list[Float32]:
    return [to_8_bit(render(model, camera, settings=drawn)) for camera in cameras]


def test_both_layers_are_read_from_one_picture(scene: MarkedScene, cameras: list[Camera]) -> None:
    claim = verify_images(shots(scene.marked, cameras[:1]), scene.opened, cameras=cameras[:1]).claim
    assert claim.layers is not None
    tint, grain, both = (claim.layers[name] for name in ("tint", "grain", "both"))
    assert min(tint, grain) > 10
    assert both > 0.93 * np.hypot(tint, grain)
    assert claim.z == pytest.approx(both)
    assert claim.tries == 6 * DRAWS
    assert 0.4 * claim.z < claim.expected_z < 1.5 * claim.z


@pytest.mark.long
def test_what_washing_left_is_read_against_a_reference_washed_alike(
    whole_scene: MarkedScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, cameras = whole_scene, seen_from(whole_scene)
    layout = scene.opened.layout
    size = float(np.sqrt(np.square(layout.displace(layout.amplitudes)).mean()))
    pictures = shots(wash(scene.marked, 7.5, size), cameras)
    known = verify_images(pictures, scene.opened, cameras=cameras).claim
    assert known.z > z_threshold(1e-9, known.tries)
    monkeypatch.setattr(reference_views, "find_color_change", lambda *_: None)  # as of a washing of another kind
    claim = verify_images(pictures, scene.opened, cameras=cameras).claim
    assert claim.layers is not None
    assert claim.z == pytest.approx(max(claim.layers.values()))
    assert known.z > 1.4 * claim.z


def test_an_unmarked_picture_says_nothing_in_any_way(scene: MarkedScene, cameras: list[Camera]) -> None:
    claim = verify_images(shots(scene.original, cameras), scene.opened, cameras=cameras).claim
    assert claim.layers is not None
    assert len(claim.layers) == 6
    assert max(abs(z) for z in claim.layers.values()) < 4.5
    assert claim.verdict.value != "marked"


def test_antialiased_pictures_show_the_grain_too(scene: MarkedScene, cameras: list[Camera]) -> None:
    """Of a model that is drawn so; its gradients are those of one that is not."""
    opened = replace(scene.opened, reference=replace(scene.opened.reference, antialiased=True))
    pictures = shots(scene.marked, cameras[:1], RasterSettings(antialiased=True))
    claim = verify_images(pictures, opened, cameras=cameras[:1]).claim
    assert claim.layers is not None
    assert claim.layers["grain"] > 8


def test_pictures_of_discs_show_it_as_well(scene: MarkedScene, cameras: list[Camera]) -> None:
    flat, seen = flatten(scene.opened.reference), flatten(scene.marked)
    assert flat.is_flat
    opened = replace(scene.opened, reference=flat)
    claim = verify_images(shots(seen, cameras[:1]), opened, cameras=cameras[:1]).claim
    assert claim.layers is not None
    assert claim.layers["grain"] > 4


def test_pictures_name_a_copy_by_its_grain_alone(scene: MarkedScene, cameras: list[Camera]) -> None:
    """Colours of nobody on the geometry of one copy: its grain is all that is left."""
    grey = scene.marked.with_(sh=scene.original.sh)
    found = trace_images(shots(grey, cameras[:1]), [scene.opened], cameras=cameras[:1])
    assert found.named
    claim = verify_images(shots(grey, cameras[:1]), scene.opened, cameras=cameras[:1]).claim
    assert claim.layers is not None
    assert claim.layers["grain"] > claim.layers["both"] > claim.layers["tint"]


def test_the_grain_is_looked_for_in_the_order_the_picture_was_blended_in(whole_scene: MarkedScene) -> None:
    """Drawn again where the picture was antialiased: sharp, but else the same."""
    opened = whole_scene.opened
    camera = make_rig(whole_scene.original, 1, 96, 96)[0]
    drawn = RasterSettings(antialiased=True, by_distance=True)
    grain = ReferenceViews(opened).at(camera, drawn).geometry
    assert grain is not None
    settings = grain.rendering.view.geometry.settings
    assert (settings.antialiased, settings.by_distance) == (False, True)
