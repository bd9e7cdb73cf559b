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
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import VerifyConfig, verify_images
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.bench.attacks import other_views, to_8_bit
from engine.lab.evaluate.marked_scene import bench_key
from engine.lab.sim.attacks import image_attack
from engine.model import GaussianModel
from engine.raster import render
from engine.watermark.rates import MADE_FIRST
from engine.watermark.statistics import DISHONEST_CLAIMANT_RATE, z_threshold

pytestmark = pytest.mark.slow

PLANT = Path(__file__).parents[1] / "data" / "plant.splat"


DIGEST = "22" * 32


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
    assert choice.report().saved_seconds is not None
    assert choice.report().saved_bytes == 0


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


def test_what_moves_is_not_rehearsed(plant: GaussianModel) -> None:
    moving = Variant(at_view=lambda model, view: model)
    with pytest.raises(InputError, match="a variant that moves is not rehearsed"):
        embed(plant, bench_key(1), original_sha256=DIGEST, config=Auto(), variant=moving)
    assert compose("auto", knobs=["view_size=300"]).unrehearsed == profile("balanced", view_size=300)
    assert compose("auto", knobs=["views=3"]).unrehearsed.views == 3
    with pytest.raises(InputError, match="survive='worst' cannot be kept"):
        _ = Auto(survive="worst").unrehearsed


def test_models_alone_need_no_pictures(few: GaussianModel) -> None:
    """No picture is read, no landmarks are made: what only pictures need is saved."""
    made = embed(few, bench_key(1), original_sha256=DIGEST, config=Auto(survive="model"))
    choice = made.report.choice
    assert choice is not None
    assert (choice.wanted_z, choice.predicted_z, choice.met) == (0.0, 0.0, True)
    assert made.config.landmark_views == 0
    assert made.config.psnr_db == 47.0


@pytest.mark.long
def test_the_worst_picture_shows_less_than_the_usual_one(few: GaussianModel) -> None:
    found = {}
    for survive in ("pictures", "worst"):
        asked = Auto(profile("fast", landmark_views=0), survive, frozenset({"psnr_db"}))
        found[survive] = choose_for(few, 16, asked).rehearsal
    assert found["worst"].predicted_z < found["pictures"].predicted_z
    assert found["worst"].held_out_db == found["pictures"].held_out_db


def test_what_is_to_survive_is_one_of_three() -> None:
    with pytest.raises(InputError, match="survive must be one of model, pictures, worst, got 'all'"):
        compose("auto", survive="all")
    with pytest.raises(InputError, match="'fast' chooses nothing"):
        compose("fast", survive="worst")


def test_a_promise_is_what_the_reader_finds(few: GaussianModel) -> None:
    """Both layers, the lattice of the file, the key's own cells: the same mark, read by `verify` in other views."""
    key = bench_key(3)
    made = embed(few, key, original_sha256=DIGEST, bits=16, config=Auto(profile("fast", landmark_views=0)))
    opened = open_record(made.record.to_bytes(key), key, MADE_FIRST)
    found = []
    for camera in other_views(few, 2, 800, (3, 1)):
        picture = image_attack("jpeg").apply(to_8_bit(render(made.model, camera)), 10, rng=np.random.default_rng(0))
        found.append(verify_images([to_8_bit(picture)], opened, VerifyConfig(), cameras=[camera]).claim.z)
    assert made.report.choice is not None
    assert np.mean(found) == pytest.approx(made.report.choice.predicted_z, rel=0.2)


def test_the_owners_cameras_that_are_no_key_views_are_the_unseen_ones(plant: GaussianModel) -> None:
    cameras = make_rig(plant, 12, 300, 200)
    choice = choose(plant, bench_key(1), 32, Auto(kept=frozenset({"psnr_db"})), DIGEST, cameras)
    assert [(c.width, c.height) for c in choice.ground.cameras] == [(256, 171)] * 6
    assert choice.rehearsal.predicted_z > 0.0


@pytest.fixture(scope="module")
def few(plant: GaussianModel) -> GaussianModel:
    """A sixth of the plant, as wide as the whole: quick, and rich enough for pictures."""
    thin = plant.take(np.arange(0, len(plant), 6))
    return thin.with_(log_scales=thin.log_scales + np.float32(np.log(6) / 2))


@pytest.mark.long
def test_more_fidelity_and_fewer_cells_foretell_less(plant: GaussianModel) -> None:
    def foretold(config: EmbedConfig) -> float:
        asked = Auto(config, kept=frozenset({"views", "psnr_db"}))
        return choose_for(plant, 32, asked).rehearsal.predicted_z

    base = foretold(profile("fast"))
    assert foretold(profile("fast", psnr_db=53.0)) < 0.85 * base  # four pictures at it show 14.8 to 19.8
    assert foretold(profile("fast", quantize=HvqConfig(cells=1024))) < 0.9 * base


def test_what_is_wanted_of_a_picture() -> None:
    assert wanted_z(16) == pytest.approx(CONFIG.auto.margin * z_threshold(DISHONEST_CLAIMANT_RATE))
    assert wanted_z(256) == pytest.approx(2 * wanted_z(64))
    assert wanted_z(256, "model") == 0.0
