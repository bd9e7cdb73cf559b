"""The quick run of the study, and its parts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from engine.formats import encode_model, read_model
from engine.lab.evaluate.cell_runner import run_cells
from engine.lab.evaluate.report import write_report
from engine.lab.evaluate.stability.odd_inputs import ODD, QUICK
from engine.lab.evaluate.stability.sameness import double_ply
from engine.lab.evaluate.stability.stability_curves import failing_first, sum_up
from engine.lab.evaluate.stability.stability_study import STUDY
from engine.lab.evaluate.study import Options, Row
from engine.model import GaussianModel
from tests.lab.evaluate.pieces import write_piece


def model(count: int = 50) -> GaussianModel:
    rng = np.random.default_rng(0)
    quats = rng.normal(size=(count, 4))
    return GaussianModel(
        rng.normal(size=(count, 3)).astype(np.float32),
        rng.normal(-3, 1, size=(count, 3)).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.normal(size=count).astype(np.float32),
        rng.normal(size=(count, 4, 3)).astype(np.float32),
    )


@pytest.mark.long
def test_quick_run(tmp_path: Path) -> None:
    options = Options((str(write_piece(tmp_path)),), quick=True)
    rows = run_cells(STUDY.cells(options), tmp_path / "cells")
    said = write_report(STUDY, rows, options, tmp_path)
    bars = {bar["what"]: bar for bar in said["bars"]}
    assert len(bars) == 5
    assert bars["odd inputs: the same claim each time or a plain refusal"]["met"]
    assert bars["again, from float64, by other numbers of threads: the same bytes of the claim"]["met"]
    assert bars["seeds, rounding, processors: the same verdict and bits, z within 0.1 %"]["met"]
    assert said["summary"]["sweeps"] == 3
    swept = {one.name: one for one in sum_up(rows)}
    assert swept["prune_random"].claimed.all()
    assert swept["prune_random"].bits_baselines["spread"][-1] < 0.9
    assert swept["jpeg"].z[0, 0] > 10 > swept["jpeg"].z[0, -1]
    assert {"figures/map-model.png", "figures/map-image.svg", "figures/attack-families.png"} <= set(said["figures"])
    assert swept["jpeg"].bits_baselines["dct"][0] > 0.65 > swept["jpeg"].bits_baselines["dct"][-1]
    page = (tmp_path / "report.html").read_text()
    assert "empty" in page
    assert json.loads((tmp_path / "results.json").read_text())["quick"] is True


def row(name: str, step: int, trial: int, z: float, psnr: float) -> Row:
    return {
        "cell": f"0-{name}",
        "what": "sweep",
        "scene": "s",
        "attack": name,
        "kind": "model",
        "reading": "literal",
        "strength": 0.1 * (step + 1),
        "step": step,
        "trial": trial,
        "bits": 1.0 if z > 5 else 0.5,
        "bits_paper": 0.9,
        "z": z,
        "z_threshold": 6.4,
        "claimed": z > 6.4,
        "psnr": psnr,
        "coverage": 1.0,
    }


def test_cheap_losses_stand_first() -> None:
    rows = []
    for name, last, look in (("holds", 50.0, 40.0), ("ruins", 0.0, 12.0), ("cheap", 0.0, 35.0)):
        for trial in range(2):
            rows += [row(name, 0, trial, 60.0, 60.0), row(name, 1, trial, last, look)]
    rows.append({"cell": "0-absent", "what": "sweep", "kind": "model", "attack": "absent", "refused": "no ffmpeg"})
    swept = failing_first(sum_up(rows))
    assert [one.name for one in swept] == ["cheap", "ruins", "holds"]
    assert [one.is_cheap for one in swept] == [True, False, False]
    cheap = swept[0]
    assert cheap.strength_of(cheap.claim_break.step) == pytest.approx(0.1 + 0.1 * (60 - 6.4) / 60)
    assert cheap.psnr_at(cheap.claim_break.step) == pytest.approx(60 - 25 * (60 - 6.4) / 60)


def test_a_double_ply_reads_as_the_single_one() -> None:
    made = model()
    double = read_model(double_ply(made), name="double.ply").model
    single = read_model(encode_model(made, "ply"), name="single.ply").model
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        assert np.array_equal(getattr(double, name), getattr(single, name)), name


@pytest.mark.parametrize("name", list(ODD))
def test_odd_inputs_keep_to_their_name(name: str) -> None:
    odd = ODD[name](model(3_000))
    assert isinstance(odd, GaussianModel)
    for array in (odd.means, odd.log_scales, odd.quats, odd.opacity_logits, odd.sh):
        assert np.isfinite(array).all()


def test_quick_ones_are_among_them() -> None:
    assert set(QUICK) <= set(ODD)
