"""`embed --profile auto`: enough for the scene, no more; the same every time; what is asked for is kept."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from engine.compress.hvq import HvqConfig
from engine.errors import InputError
from engine.evaluate.marked_scene import bench_key
from engine.formats import read_model
from engine.model import GaussianModel
from engine.pipeline import choosing
from engine.pipeline.choosing import Choice, choose, rehearse, wanted_z
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import EmbedConfig, profile
from engine.pipeline.rigs import make_rig
from engine.watermark.statistics import CHANCE_RATE, z_threshold

pytestmark = pytest.mark.slow

PLANT = Path(__file__).parents[1] / "data" / "plant.splat"


DIGEST = "22" * 32


@pytest.fixture(scope="module")
def plant() -> GaussianModel:
    return read_model(PLANT).model


def choose_for(model: GaussianModel, bits: int, asked: EmbedConfig, **options: bool) -> Choice:
    return choose(model, bench_key(1), bits, asked, original_sha256=DIGEST, **options)


def test_a_rich_scene_keeps_its_fidelity(plant: GaussianModel) -> None:
    choice = choose_for(plant, 32, profile("fast"))
    assert choice.met
    assert choice.rehearsal.predicted_z >= choice.wanted_z
    assert choice.config.psnr_db == 47.0
    assert choice.config.views == 6
    assert choice.config.view_size == choosing.VIEW_SIZE
    assert choice.rehearsal.held_out_db >= 45.0
    assert choice.report() == choose_for(plant, 32, profile("fast")).report()


def test_a_longer_message_takes_more_strength_unless_fidelity_was_asked_for(plant: GaussianModel) -> None:
    longer = choose_for(plant, 80, profile("fast"))
    assert longer.config.psnr_db < 47.0
    kept = choose_for(plant, 80, profile("fast", psnr_db=50.0), keep_psnr=True)
    assert kept.config.psnr_db == 50.0
    assert not kept.met
    out_of_reach = choose_for(plant, 256, profile("fast"))
    assert not out_of_reach.met
    assert out_of_reach.config.psnr_db == 45.0, "the strongest there is"
    assert out_of_reach.tried <= 3


def test_a_scene_of_few_gaussians_is_no_crash(plant: GaussianModel) -> None:
    choice = choose_for(plant.take(np.arange(80)), 16, profile("fast"))
    assert not choice.met
    assert math.isfinite(choice.rehearsal.predicted_z)
    with pytest.raises(InputError, match="at least 64 Gaussians, this model has 63"):
        choose_for(plant.take(np.arange(63)), 16, profile("fast"))


def test_the_embedding_goes_on_from_what_was_rehearsed_on(plant: GaussianModel) -> None:
    """Same bytes with the groundwork handed on and without; and nothing is looked at twice."""
    choice = choose_for(plant, 32, profile("fast", landmark_views=0))
    key, asked = bench_key(1), {"original_sha256": DIGEST, "config": choice.config}
    handed, anew = embed(plant, key, ground=choice.ground, **asked), embed(plant, key, **asked)
    assert handed.record.to_bytes(key) == anew.record.to_bytes(key)
    np.testing.assert_array_equal(handed.model.sh, anew.model.sh)
    assert handed.report["seconds_by_stage"]["look"] < 0.1 * anew.report["seconds_by_stage"]["look"]


def test_the_owners_cameras_that_are_no_key_views_are_the_unseen_ones(plant: GaussianModel) -> None:
    cameras = make_rig(plant, 12, 300, 200)
    choice = choose(plant, bench_key(1), 32, profile("fast"), original_sha256=DIGEST, cameras=cameras, keep_psnr=True)
    assert [(c.width, c.height) for c in choice.ground.cameras] == [(256, 171)] * 6
    assert choice.rehearsal.predicted_z > 0.0


def test_more_fidelity_and_fewer_cells_foretell_less(plant: GaussianModel) -> None:
    def foretold(config: EmbedConfig) -> float:
        return rehearse(plant, bench_key(1), config, DIGEST).predicted_z

    base = foretold(profile("fast"))
    assert foretold(profile("fast", psnr_db=53.0)) < 0.75 * base
    assert foretold(profile("fast", quantize=HvqConfig(cells=1024))) < 0.9 * base


def test_what_is_wanted_of_a_picture() -> None:
    assert wanted_z(16) > z_threshold(CHANCE_RATE)
    assert wanted_z(64) == pytest.approx(2 * wanted_z(16))
    assert wanted_z(1) == pytest.approx(choosing.MARGIN * z_threshold(CHANCE_RATE))
