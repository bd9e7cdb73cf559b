"""Domination, peers and what a run leaves for docs/results, with known answers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from engine.flows.embed.profiles import Auto, compose
from engine.lab.evaluate.figures import FAINT
from engine.lab.evaluate.pareto.pareto_cells import ATTACKS, SETTINGS
from engine.lab.evaluate.pareto.pareto_charts import Peer, dominated, draw, outdone, peers
from engine.lab.evaluate.pareto.pareto_study import PAGE, STUDY
from engine.lab.evaluate.published import Published, read_published
from engine.lab.evaluate.results_page import draw_page, read_results
from engine.lab.evaluate.study import Options


def row(setting: str, seconds: float, size: float, db: float, z: float, scene: str = "a.ply") -> dict[str, Any]:
    return {
        "scene": scene,
        "setting": setting,
        "cpu_seconds": seconds,
        "bytes": round(1000 * size),
        "bytes_whole": 1000,
        "gaussians_out": 10,
        "psnr_unseen": db,
        "psnr_of_mark": db,
        "z": {trial.label: z + k for k, trial in enumerate(ATTACKS)},
        "worst_z": z,
        "bits_right": 1.0,
    }


ROWS = [
    row("fast", 5.0, 1.0, 45.0, 20.0),
    row("balanced", 7.0, 1.0, 47.0, 20.0),
    row("strong", 7.0, 1.0, 44.0, 19.9),
    row("auto", 5.05, 1.0, 45.0, 20.1),
    row("auto, 40 dB", 15.0, 0.6, 40.0, 20.0),
    row("paper", 100.0, 0.6, 30.0, 10.0),
    row("fast", 4.0, 0.5, 50.0, 40.0, "b.ply"),
]


def test_grey_is_what_another_setting_of_the_scene_beats() -> None:
    grey = [row["setting"] for row in ROWS if dominated(row, ROWS)]
    assert grey == ["strong", "paper"], "what differs by less than a repetition does is alike"


def test_bits_as_z_bound_the_chance_of_a_wrong_key() -> None:
    whole = Peer("A", "GPU", True, 60.0, 100.0, 40.0, "v", "s")
    assert math.exp(-(whole.z**2) / 2) == pytest.approx(2.0**-32)
    all_but_one = Peer("A", "GPU", True, 60.0, 100 * 31 / 32, 40.0, "v", "s")
    assert math.exp(-(all_but_one.z**2) / 2) == pytest.approx(33 * 2.0**-32)
    assert outdone(whole, ROWS)
    assert not outdone(Peer("A", "GPU", True, 3.0, 100.0, None, "v", "s"), ROWS), "sooner than any of ours"
    assert not outdone(Peer("A", "GPU", True, 60.0, 100.0, 51.0, "v", "s"), ROWS)


def test_peers_are_at_their_worst_picture() -> None:
    def said(method: str, what: str, value: float, conditions: str, blind: bool = True) -> Published:
        return Published(method, "v", 2026, what, value, "", conditions, blind, "GPU", "s")

    some = [
        said("A", "embedding time", 60.0, ""),
        said("A", "bit accuracy", 99.0, "32 bits, no attack"),
        said("A", "bit accuracy", 91.0, "32 bits, JPEG 10"),
        said("A", "bit accuracy", 93.0, "32 bits, noise 0.1"),
        said("A", "bit accuracy", 50.0, "32 bits, clone 50 %"),
        said("B", "PSNR", 40.0, "", blind=False),
    ]
    assert peers(some) == [Peer("A", "GPU", True, 60.0, 91.0, None, "v", "s")]
    assert len(peers(read_published())) >= 5


def test_every_setting_is_a_cell_of_its_own() -> None:
    cells = STUDY.cells(Options(("a.ply", "b.compressed.ply")))
    assert len({cell.name for cell in cells}) == len(cells) == 2 * len(SETTINGS)


def test_40_dB_are_spent_with_and_without_recovery() -> None:
    spent = {setting: SETTINGS[setting] for setting in SETTINGS if "40 dB" in setting}
    made = [compose(name, budget_db=budget, knobs=knobs) for name, budget, knobs in spent.values()]
    assert [(one.start.prune.budget_db, one.start.prune.recover) for one in made if isinstance(one, Auto)] == [
        (40.0, True),
        (40.0, False),
    ]


def test_the_chart_shows_every_point_in_every_panel() -> None:
    others = peers(read_published())
    panels = draw(ROWS, others, "2 cores").axes
    points = [[(*line.get_xdata(), *line.get_ydata()) for line in axes.lines] for axes in panels]
    for row in ROWS:
        costs = (row["cpu_seconds"], row["cpu_seconds"], row["bytes"] / 10, row["psnr_unseen"])
        for cost, drawn in zip(costs, points, strict=True):
            assert (cost, row["worst_z"]) in drawn
    (listed,) = (text.get_text() for text in panels[0].texts if "Hollow" in text.get_text())
    ours, _, *published = listed.split("\n")
    assert ours == "Filled: run by us, informed, 2 cores, no GPU"
    assert [line.split(":")[0] for line in published] == [
        f"{number} {peer.name}" for number, peer in enumerate(others, start=1)
    ]
    paper = points[0].index((100.0, 10.0))
    assert panels[0].lines[paper].get_color() == FAINT != panels[0].lines[paper].get_markeredgecolor()
    assert panels[0].get_title().startswith("Ours: z 20 and more; published: z 5.")
    assert panels[1].get_title() == "Seconds: auto takes 0.72 to 0.72 of balanced"


def test_a_run_leaves_a_result_for_the_page(tmp_path: Path) -> None:
    made = STUDY.report(ROWS, Options(("a.ply", "b.ply"), seed=3))
    (tmp_path / PAGE).write_text(made.pages[PAGE])
    (result,) = read_results(tmp_path).values()
    assert result.seed == "3"
    assert result.rows[0] == ("fast", "5.0 / 4.0", "20 / 40", "100 %", "100 % / 50 %", "45.0 / 50.0")
    assert "| balanced (a) | 7.0 | 20 | 100 % |" in draw_page({"17": result})
    said = ["6 of 6 (95 %: 54 to 100 %)", "a 1.01 (one run each)", "a 0.72 (one run each)", "a 40.0"]
    assert [(bar.measured, bar.met) for bar in made.bars] == [(text, True) for text in said]
    blurred = [row | {"psnr_unseen": 38.9} if row["setting"] == "auto, 40 dB" else row for row in ROWS]
    assert not STUDY.report(blurred, Options(("a.ply",))).bars[-1].met
    torn = STUDY.report([ROWS[1] | {"bits_right": 31 / 32}], Options(("a.ply",)))
    assert [(bar.measured.split("; ")[-1], bar.met) for bar in torn.bars[:1]] == [("balanced on a 97 %", False)]
