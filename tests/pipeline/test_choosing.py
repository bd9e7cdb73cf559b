"""`embed --profile auto`: enough for the scene, no more; the same every time; what is asked for is kept."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from engine.formats import read_model
from engine.model import GaussianModel
from engine.pipeline import choosing
from engine.pipeline.choosing import choose, rehearse, wanted_z
from engine.pipeline.profiles import profile
from engine.watermark.statistics import CHANCE_RATE, z_threshold

PLANT = Path(__file__).parents[1] / "data" / "plant.splat"


@pytest.fixture(scope="module")
def plant() -> GaussianModel:
    return read_model(PLANT).model


def test_a_rich_scene_keeps_its_fidelity(plant: GaussianModel) -> None:
    choice = choose(plant, 32, profile("fast"))
    assert choice.met
    assert choice.rehearsal.predicted_z >= choice.wanted_z
    assert choice.config.psnr_db == 47.0
    assert choice.config.views == 6
    assert choice.config.view_size == choosing.VIEW_SIZE
    assert choice.rehearsal.held_out_db >= 45.0
    assert choice == choose(plant, 32, profile("fast"))


def test_a_longer_message_takes_more_strength_unless_fidelity_was_asked_for(plant: GaussianModel) -> None:
    longer = choose(plant, 80, profile("fast"))
    assert longer.config.psnr_db < 47.0
    kept = choose(plant, 80, profile("fast", psnr_db=50.0), keep_psnr=True)
    assert kept.config.psnr_db == 50.0
    assert not kept.met
    out_of_reach = choose(plant, 256, profile("fast"))
    assert not out_of_reach.met
    assert out_of_reach.config.psnr_db == 45.0, "the strongest there is"
    assert out_of_reach.tried <= 3


def test_a_scene_of_few_gaussians_is_no_crash(plant: GaussianModel) -> None:
    for count in (1, 2, 10, 80):
        choice = choose(plant.take(np.arange(count)), 16, profile("fast"))
        assert not choice.met
        assert math.isfinite(choice.rehearsal.predicted_z)


def test_more_fidelity_and_fewer_cells_foretell_less(plant: GaussianModel) -> None:
    base = rehearse(plant, profile("fast")).predicted_z
    assert rehearse(plant, profile("fast", psnr_db=53.0)).predicted_z < 0.75 * base
    fewer = profile("fast", quantize=profile("fast").quantize.__class__(cells=1024))
    assert rehearse(plant, fewer).predicted_z < 0.9 * base


def test_what_is_wanted_of_a_picture() -> None:
    assert wanted_z(16) > z_threshold(CHANCE_RATE)
    assert wanted_z(64) == pytest.approx(2 * wanted_z(16))
    assert wanted_z(1) == pytest.approx(choosing.MARGIN * z_threshold(CHANCE_RATE))
