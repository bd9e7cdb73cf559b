"""Study: the paper's tables 1 to 6 and figures 6 and 7 on our scenes.

Figure 5 is the study `steganalysis`. ``--setting table1`` runs one part, with the same cells: what a folder holds is
not measured again. On a scene of 100k Gaussians and 2 idle cores the parts take about 3 (table1), 3 (table2), 2
(table3), 5 (table4), 10 (table5), 3 (table6) and 3 minutes (fig6); all together about half an hour. The paper's own
system (`paper`: figure 7, and its column in all tables), with its thousands of steps and trainings, takes an hour more.
The report shows the lines of PAPER.md, which the whole study writes, too.
"""

from engine.errors import InputError
from engine.lab.evaluate.study import Bar, Cell, Options, Report, Row, Section, Study
from engine.lab.evaluate.summary import table
from engine.lab.evaluate.tables import as_paper, parts
from engine.lab.evaluate.tables.facing import Line, lines, page
from engine.lab.evaluate.tables.part import Part, printed

__all__ = ["PARTS", "STUDY"]

PARTS: tuple[Part, ...] = (*parts.PARTS, as_paper.PART)
TEXT = (
    "The paper: as it prints, on other scenes and other hardware, with image decoders that are blind; it describes no "
    "path from a picture to its own, informed decoder. Its system: run by us, bits by its rule (Eq 10 and 11). "
    "Pictures are from views that are not the key views, their cameras known."
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
    """Bars and lines of the chosen parts; of all parts the page PAPER.md, too."""
    wanted, every = chosen(options), lines(rows)
    bars: list[Bar] = [bar for part in wanted for bar in part.bars(rows, options)]
    met = sum(bar.met is True for bar in bars)
    answer = f"{met} of {len(bars)} bars met, {sum(bar.met is False for bar in bars)} missed."
    pages = {"PAPER.md": page(rows, options)} if wanted == PARTS else {}
    names = [name for part in wanted for name in part.tables]
    sections = [_section(name, [line for line in every if line.table == name]) for name in names]
    return Report(bars, sections, [answer] if bars else [], {"bars": len(bars), "met": met}, pages)


def _section(name: str, own: list[Line]) -> Section:
    """The lines of a table, and all that the paper prints in it."""
    faced = table(
        [vars(line) for line in own], "what", ("the paper", "paper"), ("its system, run by us", "as_paper"), "ours"
    )
    published = printed(name.lower().replace(" ", "")) if name != "Steps" else []
    theirs = [table(published, *published[0], title="As the paper prints it")] if published else []
    return Section(name, [TEXT], [faced, *theirs])


STUDY = Study(
    "tables",
    "The paper's tables and figures on our scenes",
    "What does the paper print, and what do we measure?",
    cells,
    report,
    frozenset({"quick", "settings"}),
)
