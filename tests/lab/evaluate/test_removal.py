"""Removal without a key: what is played is what it says, and the model's claim outlives its look."""

from __future__ import annotations

import numpy as np
import pytest

from engine.formats import write_model
from engine.formats.model_reading import read_model
from engine.lab.evaluate.bench import removal
from engine.lab.evaluate.bench.removal import drowned, measure_removal, members, network_colors, own_cells, wash
from engine.lab.sim.adversaries.laundering import shake, smooth
from engine.model import GaussianModel
from engine.watermark.grain import units

SCENE = "tests/data/plant.splat"


@pytest.fixture(scope="module")
def plant() -> GaussianModel:
    model = read_model(SCENE).model
    return model.take(np.arange(0, len(model), 12))


def test_washing_takes_off_what_the_neighbours_do_not_explain(plant: GaussianModel) -> None:
    whole = np.abs(wash(plant, np.inf, 0.05).sh[:, 0] - plant.sh[:, 0])
    limited = np.abs(wash(plant, 2.0, 0.05).sh[:, 0] - plant.sh[:, 0])
    assert limited.max() <= 2.0 * 0.05 + 1e-6
    assert np.median(whole) > np.median(limited) / 2
    clean = plant.with_(sh=np.zeros_like(plant.sh))
    np.testing.assert_allclose(wash(clean, np.inf, 0.05).sh, 0.0, atol=1e-6)


def test_smoothing_and_shaking(plant: GaussianModel) -> None:
    assert smooth(plant, 8).sh[:, 0].std() < plant.sh[:, 0].std()
    np.testing.assert_array_equal(smooth(plant, 1).sh, plant.sh)
    shaken = shake(plant, 2.0, np.random.default_rng(1))
    order = {color.tobytes(): row for row, color in enumerate(plant.quats)}
    rows = np.array([order[quat.tobytes()] for quat in shaken.quats])
    assert (np.diff(rows) != 1).mean() > 0.9
    size = np.linalg.norm(units(plant.log_scales), axis=1)[rows]
    moved = np.linalg.norm(shaken.means - plant.means[rows], axis=1) / size
    assert 1.2 < np.median(moved) < 2.5


def test_colors_by_cells_of_ones_own(plant: GaussianModel) -> None:
    before = plant.sh[:, 0]
    taken = members(plant, 50, 0).sh[:, 0]
    assert len(np.unique(taken, axis=0)) <= 50
    assert {color.tobytes() for color in taken} <= {color.tobytes() for color in before}
    moves = np.unique(np.round(drowned(plant, 50, 0.4, 0).sh[:, 0] - before, 4), axis=0)
    assert len(moves) <= 50
    assert 0.2 < moves.std() < 0.6
    assert np.abs(own_cells(plant, 50, 0).sh[:, 0] - before).mean() < np.abs(taken - before).mean()


def test_a_network_tells_colors_from_their_places(plant: GaussianModel) -> None:
    pytest.importorskip("torch")
    before, told = plant.sh[:, 0], network_colors(plant, 2.4, 0).sh[:, 0]
    left = np.square(told - before).mean() / np.square(before - before.mean(axis=0)).mean()
    assert 0.01 < left < 0.6


@pytest.mark.long
@pytest.mark.slow
def test_the_model_claims_while_there_is_anything_to_look_at(
    plant: GaussianModel, tmp_path: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = f"{tmp_path}/thin.ply"
    write_model(plant, path)
    monkeypatch.setattr(removal, "WASHES", (5.5,))
    monkeypatch.setattr(removal, "SMOOTH", (8,))
    monkeypatch.setattr(removal, "SHAKES", (1.0,))
    monkeypatch.setattr(removal, "CELLS", (500,))
    monkeypatch.setattr(removal, "CHAINS", ())
    rows = measure_removal(path, 1, "fast")
    assert len(rows) == 9
    for row in rows:
        assert row["psnr_db"] < 25 or row["verdict"] == "marked", row
    assert rows[0]["psnr_db"] > rows[1]["psnr_db"] > rows[4]["psnr_db"]
    assert rows[1]["layers"]["tint"] < 0.6 * rows[0]["layers"]["tint"]
