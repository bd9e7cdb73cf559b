"""Study: the paper's tables 1 to 6 and figures 6 and 7 on our scenes, and an ablation by stage.

Figure 5 is the study `steganalysis`. ``--setting table1`` runs one part, with the same cells: what a folder holds is
not measured again. On a scene of 100k Gaussians and 2 idle
cores the parts take about 3 (table1), 3 (table2), 2 (table3), 5 (table4), 10 (table5), 3 (table6), 8 (fig6), 4 (fig7)
and 4 minutes (ablation); cells that parts share run once, all together about 40 minutes. The paper's own system
(`paper`), with its thousands of steps and trainings, takes an hour more. The whole study writes PAPER.md, too.
"""

from engine.errors import InputError
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

__all__ = ["PARTS", "STUDY"]

PARTS: tuple[Part, ...] = tuple(
    module.PART for module in (table1, table2, table3, table4, table5, table6, fig6, fig7, ablation, paper)
)


def chosen(options: Options) -> tuple[Part, ...]:
    """The parts that `options.settings` names, all where it names none; InputError for an unknown one."""
    known = {part.name: part for part in PARTS}
    if unknown := [name for name in options.settings if name not in known]:
        raise InputError(f"the suite 'tables' has no setting {unknown[0]!r}; it has {', '.join(known)}")
    return tuple(known[name] for name in options.settings or known)


def cells(options: Options) -> list[Cell]:
    """Cells of the chosen parts; those that several parts need run once."""
    return list({cell.name: cell for part in chosen(options) for cell in part.cells(options)}.values())


def report(rows: list[Row], options: Options) -> Report:
    """Bars and sections of the chosen parts; of all parts the page PAPER.md, too."""
    parts = chosen(options)
    bars: list[Bar] = [bar for part in parts for bar in part.bars(rows, options)]
    met = sum(bar.met is True for bar in bars)
    answer = f"{met} of {len(bars)} bars met, {sum(bar.met is False for bar in bars)} missed."
    pages = {"PAPER.md": page(rows, options)} if parts == PARTS else {}
    sections = [part.section(rows, options) for part in parts]
    return Report(bars, sections, [answer] if bars else [], {"bars": len(bars), "met": met}, pages)


STUDY = Study(
    "tables",
    "The paper's tables and figures on our scenes",
    "What does the paper print, and what do we measure?",
    cells,
    report,
    frozenset({"quick", "settings"}),
)
