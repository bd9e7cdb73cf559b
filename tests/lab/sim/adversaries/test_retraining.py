"""A fresh model trained on renders of the marked one: the mark is seen where no Gaussian is left."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import verify_model
from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key
from engine.lab.sim.adversaries.retraining import RetrainConfig, quality_lost, retrain
from engine.lab.sim.capture.trainer import TrainConfig
from engine.model import Camera, GaussianModel
from engine.numerics.similarity import transform_model
from engine.registration.registration_search import register
from engine.watermark.rates import MADE_FIRST
from tests.registration.registration_cases import MOVES

PLANT = Path(__file__).parents[3] / "data" / "plant.splat"
CONFIG = RetrainConfig(
    points=12_000,
    train=TrainConfig(steps=240, sh_degree=0, densify=None, opacity_rate=0.02, color_rate=0.01, scale_rate=0.01),
)


@pytest.fixture(scope="module")
def scene() -> MarkedScene:
    """A third of the real plant, with a small bank of landmarks."""
    model = read_model(PLANT).model
    model = model.take(np.arange(0, len(model), 3))
    model = model.with_(log_scales=model.log_scales + np.float32(0.25))  # closes the gaps
    config = profile("fast", landmark_views=16, views=4, view_size=256, psnr_db=42)
    result = embed(model, bench_key(0), original_sha256="33" * 32, config=config)
    opened = open_record(result.record.to_bytes(bench_key(0)), bench_key(0), MADE_FIRST)
    return MarkedScene("plant", model, result.model, opened, result.report)


@pytest.fixture(scope="module")
def cameras(scene: MarkedScene) -> list[Camera]:
    return make_rig(scene.marked, 12, 192, 192, jitter=np.random.default_rng(1).random((12, 4)))


@pytest.fixture(scope="module")
def fresh(scene: MarkedScene, cameras: list[Camera]) -> GaussianModel:
    return retrain(scene.marked, cameras, CONFIG)


@pytest.mark.long
def test_no_gaussian_is_left_and_the_mark_is_still_seen(scene: MarkedScene, fresh: GaussianModel) -> None:
    assert not register(scene.opened.reference, fresh).found
    claim = verify_model(fresh, scene.opened).claim
    assert (claim.verdict.value, claim.route) == ("marked", "render")
    assert claim.log10_false_claim < -9
    assert claim.bit_accuracy > 0.9


@pytest.mark.long
def test_moved_and_trained_anew_it_is_found_by_looking(scene: MarkedScene, fresh: GaussianModel) -> None:
    scale, R, t = MOVES["large"]
    claim = verify_model(transform_model(fresh, scale, R, t), scene.opened).claim
    assert (claim.verdict.value, claim.route) == ("marked", "render")
    assert any("placed by what it looks like" in note for note in claim.notes)


@pytest.mark.long
def test_trained_on_unmarked_renders_nothing_is_claimed(scene: MarkedScene, cameras: list[Camera]) -> None:
    claim = verify_model(retrain(scene.original, cameras, CONFIG), scene.opened).claim
    assert claim.verdict.value != "marked"
    assert claim.log10_false_claim > -3


def test_training_pays_and_is_reproducible(scene: MarkedScene, cameras: list[Camera]) -> None:
    stages = {
        steps: retrain(scene.marked, cameras[:4], replace(CONFIG, train=replace(CONFIG.train, steps=steps)))
        for steps in (1, 30)
    }
    losses = {steps: quality_lost(model, scene.marked, cameras[4:6]) for steps, model in stages.items()}
    assert losses[30]["psnr_to_stolen"] > losses[1]["psnr_to_stolen"] + 1
    assert losses[30]["lost_db"] < losses[1]["lost_db"]
    again = retrain(scene.marked, cameras[:4], replace(CONFIG, train=replace(CONFIG.train, steps=30)))
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(again, name), getattr(stages[30], name))


def test_bad_requests_are_refused(scene: MarkedScene, cameras: list[Camera]) -> None:
    with pytest.raises(InputError, match="camera"):
        retrain(scene.marked, [])
    with pytest.raises(InputError, match="points"):
        RetrainConfig(points=3)
