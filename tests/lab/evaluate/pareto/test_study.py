"""The quick version of the study runs, recommends, and draws."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from engine.formats import encode_model, read_model
from engine.lab.evaluate.cell_runner import run_cells
from engine.lab.evaluate.pareto.pareto_study import STUDY
from engine.lab.evaluate.report import write_report
from engine.lab.evaluate.study import Options

PLANT = Path(__file__).parents[3] / "data" / "plant.splat"


@pytest.mark.long
def test_a_quick_run_says_what_a_scene_needs(tmp_path: Path) -> None:
    thin = read_model(PLANT).model.take(np.arange(0, 113_000, 4))
    scene = tmp_path / "thin.ply"
    scene.write_bytes(encode_model(thin, "ply"))
    options = Options((str(scene),), quick=True)
    rows = run_cells(STUDY.cells(options), tmp_path / "cells")
    assert len(rows) == 4
    for row in rows:
        assert sum(row["stages"].values()) > 0
        assert row["attacks"]["none"]["z"] > 20
        assert min(row["psnr_held_out"]) > 38
    said = write_report(STUDY, rows, options, tmp_path)
    assert {Path(name).stem for name in said["figures"]} == {"pareto", "time-fidelity", "rendering", "bytes-thin"}
    auto = said["summary"]["recommended"]["thin.ply"]["auto"]
    assert auto["views"] >= 6
    assert auto["predicted_z"] > 0
    page = (tmp_path / "report.html").read_text()
    assert "other hardware" in page
    assert "embed --profile auto" in page
    assert json.loads((tmp_path / "results.json").read_text())["quick"] is True


def test_an_sh_degree_the_scene_does_not_have_is_left_out(tmp_path: Path) -> None:
    options = Options((str(PLANT),))
    cell = next(cell for cell in STUDY.cells(options) if cell.name.endswith("SH-1"))
    assert cell.run() == []
