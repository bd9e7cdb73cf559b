"""The page that sets the paper's numbers beside ours: what is a miss, what stands where, what is left empty."""

from __future__ import annotations

from dataclasses import replace

import pytest

from engine.lab.evaluate.study import Options
from engine.lab.evaluate.tables.as_paper import cells, rows_as_paper
from engine.lab.evaluate.tables.facing import Line, lines, page
from engine.lab.evaluate.tables.tables_study import PARTS, STUDY

OPTIONS = Options(("a/plant.splat",))


def marked(name: str, right: int, **more: object) -> dict[str, object]:
    read = {"right": right, "bits": 32, "right_by_eq10": right - 4}
    return {"kind": "marked", "setting": name, "gaussians_in": 100, "gaussians_out": 40, **read, **more}


def rows() -> list[dict[str, object]]:
    """Ours reads 32 of 32 bits of a picture and a model; the paper's system, by its own rule, 28 of the model's."""
    picture = {"kind": "picture", "attack": "none", "right": 32, "bits": 32, "right_by_eq10": 32}
    view = {"kind": "view", "psnr": 20.0, "distance": 0.1}
    wrapped = [marked("paper-bits-32", 32), {**picture, "right_by_eq10": 30}, view]
    return [
        marked("bits-32", 32),
        {**picture, "setting": "bits-32"},
        {**view, "psnr": 47.5, "setting": "bits-32"},
        *({"as_paper": "table1", "name": "32", "row": row} for row in wrapped),
        {"as_paper": "fig7", "name": "gamma 0.2", "row": marked("paper-gamma-0.2", 32)},
        {"kind": "stop", "tau": 1.2, "right": 31, "bits": 32, "right_by_eq10": 30, "z": 20.0},
        {"kind": "stop", "tau": None, "right": 32, "bits": 32, "right_by_eq10": 32, "z": 30.0},
    ]


def line(what: str) -> Line:
    (found,) = [line for line in lines(rows()) if line.what == what]
    return found


def test_numbers_stand_where_they_belong() -> None:
    assert line("32 bits: bit accuracy of the model, %") == Line(
        "Table 1", "32 bits: bit accuracy of the model, %", 98.79, 87.5, 100.0
    )
    look = line("32 bits: PSNR to the original, dB")
    assert (look.paper, look.as_paper, look.ours) == (28.52, 20.0, 47.5)
    assert line("gamma 0.2: Gaussians removed, %").as_paper == pytest.approx(60.0)
    assert line("tau_occ 1.2: bit accuracy of a picture drawn with Eq 8, %").ours == 100 * 31 / 32
    assert line("tau_occ 1.2: z of that picture (no stop: 30.0)").ours == 20.0
    empty = line("JPEG 10, picture: bit accuracy, %")
    assert (empty.paper, empty.as_paper, empty.ours) == (92.21, None, None)


def test_a_miss_is_worse_than_the_paper_by_what_is_shown() -> None:
    more, less = Line("t", "w", 98.79, 87.5, 98.786), Line("t", "w", 3.0, 3.1, 2.0, 1, False)
    assert (more.misses(more.as_paper), more.misses(more.ours)) == (True, False)
    assert (less.misses(less.as_paper), less.misses(less.ours)) == (True, False)
    assert not Line("t", "w", 1.0, 0.0, 0.0, more_is_better=None).misses(0.0)
    assert not Line("t", "w", None, 0.0, 0.0).misses(0.0)


def test_misses_come_first_on_the_page() -> None:
    text = page(rows(), OPTIONS)
    ours, theirs, table = (
        text.index(part)
        for part in ("## Misses: ours is worse", "## Misses: its system, run by us is worse", "## Table 1")
    )
    assert ours < theirs < table
    assert text[ours:theirs].count("None of those measured.") == 1
    assert "| Table 1 | 32 bits: PSNR to the original, dB | 28.52 | 20.00 |" in text[theirs:table]
    assert "| 32 bits: bit accuracy of the model, % | 98.79 | 87.50 | 100.00 |" in text[table:]
    assert "| JPEG 10, picture: bit accuracy, % | 92.21 |  |  |" in text
    for name in ("Table 1", "Table 2", "Table 3", "Table 4", "Table 5", "Table 6", "Figure 6", "Figure 7", "Steps"):
        assert f"## {name}\n" in text
    assert f"Of {len(lines(rows()))} lines 7 were measured" in text
    assert "a/plant" not in text
    assert "informed" in text
    assert "quick" not in text
    assert "quick run" in page([], Options(("a/plant.splat",), quick=True))


def test_only_the_whole_study_writes_the_page() -> None:
    assert list(STUDY.report([], OPTIONS).pages) == ["PAPER.md"]
    alone = [STUDY.report([], replace(OPTIONS, settings=(part.name,))) for part in PARTS]
    assert not any(report.pages for report in alone)


def test_its_system_is_measured_in_every_table_it_can_be_in() -> None:
    made = cells(OPTIONS)
    parts = {cell.arguments["part"] for cell in made}
    assert parts == {"table1", "table2", "table3", "table5", "table6", "fig7", "steps"}
    for cell in made:
        given = cell.arguments["arguments"]
        setting = given.get("setting")
        by_profile = given.get("profile") or (setting["profile"] if isinstance(setting, dict) else None)
        ours = cell.arguments["part"] == "steps" and by_profile == "fast"
        assert str(by_profile).startswith("paper") or ours, cell.name


def test_wrapped_rows_are_nobody_elses() -> None:
    """Sections of other parts pick rows by fields that a wrapped row does not have."""
    (wrapped,) = [row for row in rows() if row.get("name") == "gamma 0.2"]
    assert set(wrapped) == {"as_paper", "name", "row"}
    assert rows_as_paper(rows(), "fig7", "gamma 0.2")[0]["gaussians_out"] == 40
    assert rows_as_paper(rows(), "fig7", "gamma 0.3") == []
