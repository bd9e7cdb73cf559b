"""The quick version of all tables: every part says something, and single suites are parts of the whole."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.formats import encode_model, read_model
from engine.lab.evaluate.cell_runner import run_cells
from engine.lab.evaluate.report import write_report
from engine.lab.evaluate.study import Options
from engine.lab.evaluate.tables.tables_study import PARTS, STUDY

PLANT = str(Path(__file__).parents[3] / "data" / "plant.splat")


@pytest.mark.long
def test_quick_run_fills_every_table(tmp_path: Path) -> None:
    thin = read_model(PLANT).model.take(np.arange(0, 113_000, 5))  # a fifth of the time
    (tmp_path / "thin.ply").write_bytes(encode_model(thin, "ply"))
    options = Options((str(tmp_path / "thin.ply"),), quick=True)
    rows = run_cells(STUDY.cells(options), tmp_path / "cells")
    said = write_report(STUDY, rows, options, tmp_path)
    page = (tmp_path / "report.html").read_text()
    for name in [name for part in PARTS for name in part.tables]:
        assert f"<h2>{name}</h2>" in page
    assert "<td>32 bits: bit accuracy of the model, %</td><td class=n>98.79</td><td class=n>100</td>" in page
    assert "<td>GuardSplat</td>" in page, "what the paper prints of others"
    bars = {bar["what"]: bar["met"] for bar in said["bars"]}
    assert bars["32 bits, no attack (pictures and models)"] is True
    assert bars["fidelity of the mark, 32 bits, worst key view"] is True
    assert bars["unmarked model, claims"] is True
    assert bars["the paper's system, model, bits by Eq 10"] is True
    faced = (tmp_path / "PAPER.md").read_text()
    assert "| 32 bits: bit accuracy of the model, % | 98.79 | 100.00 | 100.00 |" in faced
    assert "| tau_occ 1.2: bit accuracy of a picture drawn with Eq 8, % |  |  | 1" in faced
    assert bars["256 bits, no attack (pictures and models)"] is None, "what was not run is not met"
    assert not [what for what, met in bars.items() if met is False]
    assert "informed" in page
    results = json.loads((tmp_path / "results.json").read_text())
    marked = [row for row in results["rows"] if row.get("kind") == "marked" and row["setting"] != "unmarked"]
    assert all(row["right"] == 32 and row["z"] > 30 for row in marked)
    unmarked = [row for row in results["rows"] if row.get("setting") == "unmarked" and "claimed" in row]
    assert unmarked
    assert not any(row["claimed"] for row in unmarked)


@pytest.mark.parametrize("quick", [True, False])
def test_single_suites_are_parts_of_the_whole(quick: bool) -> None:
    options = Options(("a/plant.splat", "b/plant.splat"), quick=quick)
    whole = {cell.name: cell.digest for cell in STUDY.cells(options)}
    every = [cell for part in PARTS for cell in STUDY.cells(replace(options, settings=(part.name,)))]
    assert {cell.name: cell.digest for cell in every} == whole
    assert all(whole[cell.name] == cell.digest for cell in every), "cells of one name do one thing"


def test_an_unknown_part_is_refused() -> None:
    with pytest.raises(InputError, match="no setting 'table7'"):
        STUDY.cells(Options((PLANT,), settings=("table7",)))


def test_report_without_rows_measures_nothing_and_breaks_nothing() -> None:
    options = Options((PLANT,))
    assert all(bar.met is None for bar in STUDY.report([], options).bars)
