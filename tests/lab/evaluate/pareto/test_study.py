"""The quick version of the study runs and draws."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from engine.formats import encode_model, read_model
from engine.lab.evaluate.cell_runner import run_cells
from engine.lab.evaluate.pareto.pareto_study import PAGE, STUDY
from engine.lab.evaluate.report import write_report
from engine.lab.evaluate.study import Options

PLANT = Path(__file__).parents[3] / "data" / "plant.splat"


@pytest.mark.long
def test_a_quick_run_measures_and_draws(tmp_path: Path) -> None:
    thin = read_model(PLANT).model.take(np.arange(0, 113_000, 4))
    scene = tmp_path / "thin.ply"
    scene.write_bytes(encode_model(thin, "ply"))
    options = Options((str(scene),), quick=True)
    rows = run_cells(STUDY.cells(options), tmp_path / "cells")
    assert [row["setting"] for row in rows] == ["fast", "auto"]
    for row in rows:
        assert row["cpu_seconds"] > 0
        assert row["z"]["crop to 10 %"] > 20
        assert row["psnr_unseen"] > 38
        assert 0.9 < row["bytes"] / row["bytes_whole"] < 1.1
    said = write_report(STUDY, rows, options, tmp_path)
    assert said["figures"] == ["figures/pareto.svg", "figures/pareto.png"]
    assert "other hardware" in (tmp_path / "report.html").read_text()
    assert json.loads((tmp_path / PAGE).read_text())["machine"]
