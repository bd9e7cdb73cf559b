"""Cells run once, wherever they run, and a broken run goes on where it stopped."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from engine.errors import InputError
from engine.lab.evaluate.cell_runner import run_cells
from engine.lab.evaluate.study import Cell

WORK = "tests.lab.evaluate.cells:square"


def cells(values: list[float], log: Path | None = None) -> list[Cell]:
    extra = {} if log is None else {"log": str(log)}
    return [Cell(f"v{k}", WORK, {"value": value, **extra}) for k, value in enumerate(values)]


def test_rows_in_the_order_of_the_cells(tmp_path: Path) -> None:
    reports: list[tuple[str, float]] = []
    rows = run_cells(cells([3.0, 1.0, 2.0]), tmp_path, tell=lambda name, done: reports.append((name, done)))
    assert [(row["cell"], row["square"]) for row in rows] == [("v0", 9.0), ("v1", 1.0), ("v2", 4.0)]
    assert reports[-1] == ("v2", 1.0)
    stored = json.loads((tmp_path / "v0.json").read_text())
    assert stored["arguments"] == {"value": 3.0}
    assert stored["seconds"] >= 0
    assert stored["machine"]["cores"] >= 1


def test_what_is_there_is_not_measured_again(tmp_path: Path) -> None:
    log, folder = tmp_path / "log", tmp_path / "cells"
    with pytest.raises(InputError, match=r"cell v2: -1\.0 is negative"):
        run_cells(cells([1.0, 2.0, -1.0, 4.0], log), folder)
    assert log.read_text().split() == ["1.0", "2.0", "-1.0"]
    rows = run_cells(cells([1.0, 2.0, 3.0, 4.0], log), folder)
    assert [row["square"] for row in rows] == [1.0, 4.0, 9.0, 16.0]
    assert log.read_text().split() == ["1.0", "2.0", "-1.0", "3.0", "4.0"]


def test_other_arguments_or_half_a_file_are_measured_again(tmp_path: Path) -> None:
    run_cells(cells([1.0, 2.0]), tmp_path)
    (tmp_path / "v1.json").write_text('{"digest": "')
    assert [row["square"] for row in run_cells(cells([5.0, 2.0]), tmp_path)] == [25.0, 4.0]


def test_processes_and_a_cluster_give_the_same_rows(tmp_path: Path) -> None:
    from distributed import LocalCluster

    here = run_cells(cells([1.0, 2.0, 3.0]), tmp_path / "here")
    assert run_cells(cells([1.0, 2.0, 3.0]), tmp_path / "two", workers=2) == here
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        assert run_cells(cells([1.0, 2.0, 3.0]), tmp_path / "dask", dask=cluster.scheduler_address) == here


def test_an_error_in_a_process_is_the_callers_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is negative"):
        run_cells(cells([1.0, -2.0]), tmp_path, workers=2)


def test_names() -> None:
    with pytest.raises(InputError, match="name of a cell"):
        Cell("a/b", WORK, {})
    with pytest.raises(InputError, match="two cells are called 'a'"):
        run_cells([Cell("a", WORK, {"value": 1.0})] * 2, Path("nowhere"))
