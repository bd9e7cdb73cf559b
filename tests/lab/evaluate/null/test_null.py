"""The quick run of the calibration, and its counts."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from engine.lab.evaluate.cell_runner import run_cells
from engine.lab.evaluate.null.null_rates import (
    LOG10_THRESHOLDS,
    Rates,
    above,
    add_up,
    count_wrong_keys,
    exceeding,
    share_claimed,
)
from engine.lab.evaluate.null.null_study import STUDY
from engine.lab.evaluate.report import write_report
from engine.lab.evaluate.study import Cell, Options
from tests.lab.evaluate.pieces import write_piece


def small(cell: Cell) -> Cell:
    """As little of a quick cell as tells that it works."""
    least = {"keys": min(cell.arguments.get("keys", 0), 4_000)} if "keys" in cell.arguments else {}
    return Cell(cell.name, cell.work, {**cell.arguments, **least})


@pytest.mark.long
def test_quick_run(tmp_path: Path) -> None:
    options = Options((str(write_piece(tmp_path)),), quick=True)
    cells = STUDY.cells(options)
    assert sum(cell.arguments.get("keys", 0) for cell in cells) > 100_000
    rows = run_cells([small(cell) for cell in cells], tmp_path / "cells")
    said = write_report(STUDY, rows, options, tmp_path)
    missed = [bar["what"] for bar in said["bars"] if not bar["met"]]
    assert missed == ["wrong keys tried"]
    assert said["summary"]["claims"] == 0
    assert said["summary"]["largest_z"] < 6.0
    wrong = next(row for row in rows if row["what"] == "wrong detector")
    assert wrong["claims"] == wrong["keys"] > 0
    assert "A claim needs" in (tmp_path / "report.html").read_text()


def test_counts_at_known_values() -> None:
    at_1e3 = math.sqrt(2 * 3 * math.log(10)) + 1e-9
    hits = above([at_1e3, 0.0, 100.0, -100.0])
    assert hits[LOG10_THRESHOLDS.index(-3.0)] == 2
    assert hits[LOG10_THRESHOLDS.index(-3.25)] == 1
    assert hits[-1] == 1
    assert share_claimed([at_1e3, 0.0], -3.0) == 0.5


def test_wrong_keys_on_one_chip_and_on_many() -> None:
    """One chip: z is a coin of +-1, and P(z >= 1) = 1/2 lies below exp(-1/2)."""
    counted = count_wrong_keys(np.array([3.0]), np.ones(1), 20_000, "one")
    assert counted["z_largest"] == pytest.approx(1.0)
    assert counted["z_std"] == pytest.approx(1.0, abs=0.01)
    many = count_wrong_keys(np.random.default_rng(0).normal(size=500), np.ones(500), 20_000, 0)
    assert many["z_mean"] == pytest.approx(0.0, abs=0.03)
    assert not exceeding(add_up([counted, many], "both"))


def test_a_rate_above_the_bound_is_seen() -> None:
    hits = [0] * len(LOG10_THRESHOLDS)
    hits[LOG10_THRESHOLDS.index(-3.0)] = 50
    assert exceeding(Rates("too many", 10_000, tuple(hits))) == [-3.0]
    hits[LOG10_THRESHOLDS.index(-3.0)] = 12
    assert not exceeding(Rates("by chance", 10_000, tuple(hits)))
