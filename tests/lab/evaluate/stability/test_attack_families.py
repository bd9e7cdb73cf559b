"""The figure and table of attack families: known answers, and what is committed is what the curves give."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.evaluate.results_page import draw_page, read_results
from engine.lab.evaluate.stability.attack_families import FAMILIES, draw_families, family_curves, family_result, main
from engine.lab.evaluate.stability.stability_study import STUDY
from engine.lab.evaluate.stability.sweeps import all_sweeps
from engine.lab.evaluate.study import Options, Row

DOCS = Path(__file__).parents[4] / "docs"


def rows(scene: str, z: list[float], qim: list[float], trials: int = 2) -> list[Row]:
    """A sweep of crops: ours keeps its bits down to z 10; QIM is read in the first trial."""
    made: list[Row] = []
    for trial in range(trials):
        for step, score in enumerate(z):
            row: Row = {"attack": "crop", "kind": "model", "reading": "literal", "scene": scene, "trial": trial}
            row |= {"step": step, "strength": [0.9, 0.5, 0.1][step], "z": score, "z_threshold": 6.4}
            row["bits"] = 1.0 if score > 10 else 0.5
            made.append(row if trial or not qim else row | {"bits_qim": qim[step], "psnr": 40.0 - 10 * step})
    return made


ROWS = rows("a.ply", [90.0, 50.0, 30.0], [1.0, 0.5, 0.5]) + rows("b.ply", [90.0, 45.0, 2.4], [1.0, 0.75, 0.5])
OTHERS: list[Row] = [
    {"attack": "crop", "reading": "as_code", "scene": "a.ply", "z": 1.0},
    {"attack": "crop", "reading": "literal", "scene": "a.ply", "refused": "too small"},
    {"attack": "noise_dc", "reading": "literal", "scene": "a.ply", "z": 1.0},
]
ABOUT = {"command": "c", "seed": "0", "machine": "m", "commit": "abc"}


def test_each_method_breaks_where_its_bits_fall_below_26_of_32() -> None:
    curves = family_curves(ROWS + OTHERS)
    assert [(curve["scene"], curve["method"]) for curve in curves] == [
        ("a.ply", "ours"), ("a.ply", "qim"), ("b.ply", "ours"), ("b.ply", "qim"),
    ]  # fmt: skip
    assert curves[0]["psnr"] == [40.0, 30.0, 20.0]
    ((what, claim, ours, qim, worst),) = family_result({**ABOUT, "curves": curves})["rows"]
    assert what == FAMILIES["crop"]
    assert claim == "never", "the mean of z stays above: 16.2"
    # Ours 1, 1, 0.75: 0.8125 after 3/4 of the last step; QIM 1, 0.625, 0.5: after half of the first.
    assert ours.startswith("0.15 (")
    assert qim.startswith("0.67 (")
    assert worst.startswith("b: 0.12, z"), "no interval where all trials are alike"
    assert worst.endswith("z 2.4 at 0.1")


def test_the_figure_names_methods_readings_and_the_worst_scene() -> None:
    drawn = draw_families(family_curves(ROWS))
    said = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert {"ours, informed", "QIM, blind", "spread spectrum, informed", "DCT at 35 dB, blind"} < set(said)
    panel = drawn.axes[0]
    assert "worst scene b" in panel.get_xlabel()
    lines = {line.get_label(): np.asarray(line.get_ydata()).tolist() for line in panel.lines}
    assert lines["ours, informed"] == [100.0, 100.0, 75.0]
    assert len(panel.collections) == 2, "an interval for each method that breaks"
    lost = draw_families(family_curves(rows("b.ply", [90.0, 46.4, 2.4], [1.0, 1.0, 1.0]))).axes[0]
    assert [np.asarray(line.get_xdata()).tolist() for line in lost.lines if line.get_linestyle() == ":"] == [
        [pytest.approx(1 + 40 / 44)] * 2
    ]


def test_what_is_not_read_counts_as_chance() -> None:
    (curve,) = family_curves([row | {"bits": 0.0} for row in rows("a.ply", [2.0], [], 1)])
    assert curve["bits"] == [[0.5]]


def test_the_part_of_the_suite_is_the_six_sweeps_alone() -> None:
    cells = STUDY.cells(Options(("a.ply",), settings=("families",)))
    assert {cell.name for cell in cells} == {f"0-{name}" for name in FAMILIES}
    assert set(FAMILIES) <= {sweep.name for sweep in all_sweeps()}
    with pytest.raises(InputError, match="familys"):
        STUDY.cells(Options(("a.ply",), settings=("familys",)))


def test_a_run_leaves_curves_from_which_figure_and_table_are_made(tmp_path: Path) -> None:
    kind = {"cell": "0-crop", "bits_paper": 1.0, "claimed": True}
    made = STUDY.report([kind | row | {"what": "sweep"} for row in ROWS], Options(("x/a.ply",), settings=("families",)))
    assert [bar.what.split(" ")[2] for bar in made.bars] == ["models", "one"], "nothing of what was not run"
    (tmp_path / "curves.json").write_text(made.pages["attack_families.json"])
    assert main([str(tmp_path / name) for name in ("curves.json", "f.png", "21.json")]) == 0
    (tmp_path / "curves.json").unlink()
    (result,) = read_results(tmp_path).values()
    assert "--setting families --scene a.ply" in result.command
    assert "Blind methods solve a harder problem" in draw_page({"21": result})
    assert (tmp_path / "f.png").read_bytes()[:4] == b"\x89PNG"
    assert main([]) == 2


def test_the_committed_table_is_what_its_curves_give() -> None:
    kept = json.loads((DOCS / "results/curves/attack_families.json").read_text())
    assert family_result(kept) == json.loads((DOCS / "results/21_attack_families.json").read_text())
