"""Models that would take hours to draw are refused before anything is drawn, and read where nothing has to be."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.verify.search import VerifyConfig, verify_model
from engine.flows.views import view_set as scenes
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.config import CONFIG
from engine.flows.views.render_cost import check_drawable
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.model import GaussianModel
from engine.raster import count_overlaps, prepare_view
from engine.watermark.claim import Verdict
from engine.watermark.keys import OwnerKey
from tests.raster.scenes import camera, random_discs, random_model
from tests.scenes import screened


@pytest.mark.parametrize("make", [random_model, random_discs])
def test_overlaps_are_told_without_drawing(make: object) -> None:
    """No fewer than there are, and not many more: the rectangle around an ellipse."""
    model, eye = make(3000, seed=5), camera(320, 240, 300.0)  # type: ignore[operator]
    counted, listed = count_overlaps(model, eye), np.diff(prepare_view(model, eye).geometry.firsts)[: len(model)]
    assert counted.shape == listed.shape
    assert (counted >= listed).all()
    assert listed.sum() <= counted.sum() < 2.5 * listed.sum()


def test_real_scenes_are_far_from_the_bound(plant: GaussianModel) -> None:
    most = max(count_overlaps(plant, eye).sum() for eye in make_rig(plant, 8, CONFIG.cost.side, CONFIG.cost.side))
    assert 20 * most < CONFIG.cost.most_pairs


def test_an_embedding_is_refused_before_it_draws(plant: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "prepare_view", lambda *_: pytest.fail("it draws"))
    text = r"cover 25\d million tiles of view 1,.* 30 million are allowed; 100,00\d of its 213,648 Gaussians"
    for config in (profile("fast", view_size=256), profile("fast", view_size=800)):
        with pytest.raises(InputError, match=text):
            embed(screened(plant, 100_000), OwnerKey(bytes(range(32))), original_sha256="00" * 32, config=config)


def test_no_number_saves_what_covers_little(plant: GaussianModel) -> None:
    """A hundred thousand Gaussians of a pixel are a scene like others, in a tiny picture, too, of one tile."""
    many = screened(plant, 100_000, size=1e-3)
    check_drawable(many)
    check_drawable(many, make_rig(many, 2, 16, 16))


def test_a_suspect_is_read_by_its_gaussians_and_drawn_by_nobody(whole_scene: MarkedScene) -> None:
    """Whoever hangs veils before a stolen model is found out all the same."""
    scene = whole_scene
    veiled = screened(scene.marked, 100_000)
    assert verify_model(veiled, scene.opened).claim.verdict is Verdict.MARKED
    for route in ("auto", "render"):
        foreign = screened(random_model(2000, seed=6, coefficients=1), 100_000)
        with pytest.raises(InputError, match="takes too long to draw"):
            verify_model(foreign, scene.opened, VerifyConfig(route=route))
