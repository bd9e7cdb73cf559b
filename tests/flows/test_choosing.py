"""`embed --profile auto`: enough for the scene, no more; the same every time; what is asked for is kept."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from engine.compress.hvq import HvqConfig
from engine.errors import InputError
from engine.flows.embed.auto_profile import Choice, choose, wanted_z
from engine.flows.embed.config import CONFIG
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import Auto, EmbedConfig, compose, profile
from engine.flows.embed.variant import Variant
from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.lab.evaluate.marked_scene import bench_key
from engine.lab.evaluate.pareto.pareto_cells import rehearse
from engine.model import GaussianModel
from engine.watermark.statistics import CHANCE_RATE, z_threshold

pytestmark = pytest.mark.slow

PLANT = Path(__file__).parents[1] / "data" / "plant.splat"


DIGEST = "22" * 32


@pytest.fixture(scope="module")
def plant() -> GaussianModel:
    return read_model(PLANT).model


def choose_for(model: GaussianModel, bits: int, asked: Auto | None = None) -> Choice:
    return choose(model, bench_key(1), bits, asked or Auto(), DIGEST)


@pytest.mark.long
def test_a_rich_scene_keeps_its_fidelity(plant: GaussianModel) -> None:
    choice = choose_for(plant, 32)
    assert choice.met
    assert choice.rehearsal.predicted_z >= choice.wanted_z
    assert choice.config.psnr_db == 47.0
    assert choice.config.views == 6
    assert choice.config.view_size == CONFIG.auto.view_size
    assert choice.rehearsal.held_out_db >= 45.0
    assert choice.report() == choose_for(plant, 32).report()


@pytest.mark.long
def test_a_longer_message_takes_more_strength_unless_fidelity_was_asked_for(plant: GaussianModel) -> None:
    longer = choose_for(plant, 80)
    assert longer.config.psnr_db < 47.0
    kept = choose_for(plant, 80, compose("auto", psnr_db=50.0))
    assert kept.config.psnr_db == 50.0
    assert not kept.met
    out_of_reach = choose_for(plant, 256)
    assert not out_of_reach.met
    assert out_of_reach.config.psnr_db == 45.0, "the strongest there is"
    assert out_of_reach.tried <= 3


def test_a_scene_of_few_gaussians_is_no_crash(plant: GaussianModel) -> None:
    choice = choose_for(plant.take(np.arange(80)), 16)
    assert not choice.met
    assert math.isfinite(choice.rehearsal.predicted_z)
    with pytest.raises(InputError, match="at least 64 Gaussians, this model has 63"):
        choose_for(plant.take(np.arange(63)), 16)


@pytest.mark.long
def test_an_embedding_that_chose_is_the_embedding_of_what_it_chose(plant: GaussianModel) -> None:
    """Same bytes with settings left open and named; what was rehearsed on is not looked at again."""
    key, auto = bench_key(1), Auto(profile("fast", landmark_views=0))
    chosen = embed(plant, key, original_sha256=DIGEST, config=auto)
    named = embed(plant, key, original_sha256=DIGEST, config=chosen.config)
    assert chosen.config == choose_for(plant, 32, auto).config
    assert chosen.record.to_bytes(key) == named.record.to_bytes(key)
    np.testing.assert_array_equal(chosen.model.sh, named.model.sh)
    assert chosen.report["seconds_by_stage"]["look"] < 0.1 * named.report["seconds_by_stage"]["look"]
    assert (chosen.report["choice"]["views"], named.report["choice"]) == (chosen.config.views, None)


def test_a_variant_is_not_rehearsed(plant: GaussianModel) -> None:
    labels = np.zeros(len(plant), np.int32)
    with pytest.raises(InputError, match="a variant is not rehearsed"):
        embed(plant, bench_key(1), original_sha256=DIGEST, config=Auto(), variant=Variant(labels=labels))


def test_the_owners_cameras_that_are_no_key_views_are_the_unseen_ones(plant: GaussianModel) -> None:
    cameras = make_rig(plant, 12, 300, 200)
    choice = choose(plant, bench_key(1), 32, Auto(keep_psnr=True), DIGEST, cameras)
    assert [(c.width, c.height) for c in choice.ground.cameras] == [(256, 171)] * 6
    assert choice.rehearsal.predicted_z > 0.0


@pytest.mark.long
def test_more_fidelity_and_fewer_cells_foretell_less(plant: GaussianModel) -> None:
    def foretold(config: EmbedConfig) -> float:
        return rehearse(plant, bench_key(1), config, DIGEST).predicted_z

    base = foretold(profile("fast"))
    assert foretold(profile("fast", psnr_db=53.0)) < 0.75 * base
    assert foretold(profile("fast", quantize=HvqConfig(cells=1024))) < 0.9 * base


def test_what_is_wanted_of_a_picture() -> None:
    assert wanted_z(16) > z_threshold(CHANCE_RATE)
    assert wanted_z(64) == pytest.approx(2 * wanted_z(16))
    assert wanted_z(1) == pytest.approx(CONFIG.auto.margin * z_threshold(CHANCE_RATE))
