"""The quick version of the study measures every axis and draws it; a cell can run in a process of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.formats import encode_model, read_model
from engine.lab.evaluate.cell_runner import run_cells
from engine.lab.evaluate.cost.cost_cells import measure_size
from engine.lab.evaluate.cost.cost_study import STUDY
from engine.lab.evaluate.report import write_report
from engine.lab.evaluate.study import Options

PLANT = Path(__file__).parents[3] / "data" / "plant.splat"


@pytest.fixture
def scene(tmp_path: Path) -> str:
    path = tmp_path / "thin.ply"
    path.write_bytes(encode_model(read_model(PLANT).model.take(np.arange(0, 113_000, 20)), "ply"))
    return str(path)


@pytest.mark.long
def test_a_quick_run_measures_every_axis(scene: str, tmp_path: Path) -> None:
    options = Options((scene,), quick=True)
    rows = run_cells(STUDY.cells(options), tmp_path / "cells")
    said = write_report(STUDY, rows, options, tmp_path)
    drawn = {Path(name).stem for name in said["figures"]}
    assert drawn == {"growth-gaussians-thin", "growth-views-thin", "growth-pixels-thin", "formats"}
    exponents = said["summary"]["exponents"]["thin.ply"]
    assert set(exponents) == {"gaussians", "views", "pixels"}
    sized = [row for row in rows if row.get("axis") == "gaussians"]
    assert [row["gaussians"] for row in sized] == [2_500, 5_000]
    assert not said["bars"], "nothing is promised of so few Gaussians"
    assert "quick run" in (tmp_path / "report.html").read_text()


def test_a_process_of_its_own_knows_its_own_memory(scene: str) -> None:
    row = measure_size(
        scene,
        "gaussians",
        1_500,
        0,
        gaussians=1_500,
        views=2,
        view_size=64,
        landmarks=0,
        repeats=1,
        raster_size=(64, 48),
        picture_size=64,
    )[0]
    assert row["gaussians"] == 1_500
    assert 50 < row["memory_before_mb"] <= row["peak_memory_mb"] <= row["peak_memory_all_mb"]
