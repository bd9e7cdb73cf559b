"""Study: the paper's tables 1 to 6 and figures 6 and 7 on our scenes, and an ablation by stage.

Figure 5 is the study `steganalysis`. Each part is also a suite of its own (``--suite table1`` ...), with the same
cells: a folder of one holds nothing that the whole study would measure again. On a scene of 100k Gaussians and 2 idle
cores the parts take about 3 (table1), 3 (table2), 2 (table3), 5 (table4), 10 (table5), 3 (table6), 8 (fig6), 4 (fig7)
and 4 minutes (ablation); cells that parts share run once, all together about 40 minutes. The paper's own system
(`paper`), with its thousands of steps and trainings, takes an hour more. The whole study writes PAPER.md, too.
"""

from collections.abc import Sequence

from engine.lab.evaluate.study import Bar, Cell, Options, Report, Row, Study
from engine.lab.evaluate.tables.facing import page
from engine.lab.evaluate.tables.part import Part
from engine.lab.evaluate.tables.sections import (
    ablation,
    fig6,
    fig7,
    paper,
    table1,
    table2,
    table3,
    table4,
    table5,
    table6,
)

__all__ = ["PARTS", "STUDY", "studies"]

PARTS: tuple[Part, ...] = tuple(
    module.PART for module in (table1, table2, table3, table4, table5, table6, fig6, fig7, ablation, paper)
)


def make_study(name: str, title: str, question: str, parts: Sequence[Part]) -> Study:
    """A study of some parts; cells that several ask for run once."""

    def cells(options: Options) -> list[Cell]:
        return list({cell.name: cell for part in parts for cell in part.cells(options)}.values())

    def report(rows: list[Row], options: Options) -> Report:
        bars: list[Bar] = [bar for part in parts for bar in part.bars(rows, options)]
        met = sum(bar.met is True for bar in bars)
        answer = f"{met} of {len(bars)} bars met, {sum(bar.met is False for bar in bars)} missed."
        sections = [part.section(rows, options) for part in parts]
        pages = {"PAPER.md": page(rows, options)} if parts is PARTS else {}
        return Report(bars, sections, [answer] if bars else [], {"bars": len(bars), "met": met}, pages)

    return Study(name, title, question, cells, report)


STUDY = make_study(
    "tables",
    "The paper's tables and figures on our scenes",
    "What does the paper print, and what do we measure?",
    PARTS,
)


def studies() -> dict[str, Study]:
    """One study for each part, by name."""
    return {part.name: make_study(part.name, part.title, part.question, [part]) for part in PARTS}
