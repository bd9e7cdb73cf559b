"""The paper's own system, run: what it reads, and what more steps of its refinement change."""

from statistics import fmean

from engine.lab.evaluate.study import Bar, Cell, Options, Row, Section
from engine.lab.evaluate.summary import accuracy, mean_text, picked, share_text, table
from engine.lab.evaluate.tables import as_paper
from engine.lab.evaluate.tables.part import CONDITIONS, Part


def cells(options: Options) -> list[Cell]:
    """Of `as_paper`."""
    return as_paper.cells(options)


def section(rows: list[Row], options: Options) -> Section:
    """Every marking by its system: bits by both decoders, look, time."""
    found = [
        {"table": part, "name": name, "of": of}
        for part in ("table1", "table6", "fig7", "steps")
        for name in dict.fromkeys(row["name"] for row in as_paper.rows_as_paper(rows, part))
        if picked(of := as_paper.rows_as_paper(rows, part, name), kind="marked")
    ]

    def kind(line: Row, name: str) -> list[Row]:
        return picked(line["of"], kind=name)

    shown = table(
        found,
        "table",
        ("setting", "name"),
        ("Gaussians left, %", lambda line: mean_text([100 * _left(row) for row in kind(line, "marked")])),
        ("bits of the model, Eq 10", lambda line: share_text(accuracy(kind(line, "marked"), "right_by_eq10"))),
        ("ours", lambda line: share_text(accuracy(kind(line, "marked")))),
        *(
            (f"z of a picture, {seen}", lambda line, seen=seen: mean_text([r["z"] for r in _pictures(line, seen)]))
            for seen in CONDITIONS
        ),
        ("worst key view, mark alone, dB", lambda line: min(row["psnr_worst_view"] for row in kind(line, "marked"))),
        ("with pruning and codes", lambda line: min(row["psnr_total_worst_view"] for row in kind(line, "marked"))),
        ("refinement, s", lambda line: f"{fmean(row['refine_seconds'] for row in kind(line, 'marked')):.0f}"),
        title="Its system, by setting",
    )
    return Section(
        "The system of the paper, run by us",
        [
            f"`--profile paper`, {as_paper.STEPS} Adam steps where nothing else is said, the strength solved again "
            "after them. Bits of the model are read by the paper's rule (Eq 10 and 11) and by our decoder, from one "
            "evidence.",
            "The table that compares with the paper's own numbers is PAPER.md of the suite `tables`.",
        ],
        [shown],
    )


def _left(row: Row) -> float:
    return float(row["gaussians_out"] / row["gaussians_in"])


def _pictures(line: Row, attack: str) -> list[Row]:
    return picked(line["of"], kind="picture", attack=attack)


def bars(rows: list[Row], options: Options) -> list[Bar]:
    """Its own decoder reads every bit of the model that its own settings marked."""
    read = [row for row in as_paper.rows_as_paper(rows, "table1") if row["kind"] == "marked"]
    if not read:
        return []
    found = accuracy(read, "right_by_eq10")
    whole = found is not None and found.share == 1.0
    return [Bar("the paper's system, model, bits by Eq 10", "100 %", str(found), whole)]


PART = Part(
    "paper",
    "The paper's system, run by us",
    "What does the paper's own system do here, and what do more steps change?",
    cells,
    section,
    bars,
)
