"""Table 2: 32 bits after each attack, in both readings of it, on pictures and on models."""

from typing import Any

from engine.lab.evaluate.figures import Figure, figure, styles
from engine.lab.evaluate.study import Bar, Cell, Drawing, Options, Row, Section, Table
from engine.lab.evaluate.summary import INTERVALS, Accuracy, accuracy, picked, range_text, table
from engine.lab.evaluate.tables.part import MEASURING, PUBLISHED, Part, changes_of, efforts, printed, scenes_of, system

COLUMNS = {
    "none": "no attack",
    "rotation": "rotation 30 deg",
    "scaling": "scale 0.75",
    "crop": "crop 40 %",
    "jpeg": "JPEG 10",
    "noise": "noise 0.1",
    "clone": "clone 50 %",
    "prune": "prune 20 %",
}
CUTS = ("10 % left, random", "10 % left, one piece")
QUICK = ("none", "jpeg", "crop", "clone")
WAYS = (
    ("picture", "literal", "one picture, literal"),
    ("picture", "as_code", "one picture, as public code runs it"),
    ("model", "literal", "model, literal"),
    ("model", "as_code", "model, as public code runs it"),
)
MEANINGS = (
    ("rotation", "turned by 30 deg, black corners", "by a random angle up to 30 deg", "turned by 30 deg"),
    ("scaling", "each side x0.75", "area x0.75", "x0.75"),
    (
        "crop",
        "40 % of the area cut away",
        "centred, sides x0.4 (16 % of the area left)",
        "a connected 60 % left; as code: 40 % of the file's rows dropped as a block",
    ),
    ("jpeg", "quality 10, 4:2:0", "the same", "-"),
    ("noise", "std 0.1", "std 0.01 (0.1 is squared first)", "std 0.1 of each attribute's own, on all"),
    ("clone", "-", "-", "half of the Gaussians split into look-alike pairs; as code: copied as they are"),
    ("prune", "-", "-", "a random fifth removed"),
)


def cells(options: Options) -> list[Cell]:
    """Pictures and models of every scene under every key."""
    effort, _ = efforts(options)
    columns = list(QUICK if options.quick else (*COLUMNS, *CUTS))
    made = []
    for short, path in scenes_of(options):
        for seed in range(options.seed, options.seed + effort.keys):
            on = {"scene": path, "seed": seed, "changes": changes_of(options), "columns": columns}
            seen = {**on, "views": effort.views, "size": effort.size}
            made.append(Cell(f"table2-pictures-{short}-k{seed}", f"{MEASURING}:attack_pictures", seen))
            made.append(Cell(f"table2-models-{short}-k{seed}", f"{MEASURING}:attack_models", on))
    return made


def section(rows: list[Row], options: Options) -> Section:
    """The paper's eight columns, ours in four readings, and each with its intervals."""
    wide: list[list[Any]] = []
    for on, reading, name in WAYS:
        found = [_found(rows, on, reading, column) for column in COLUMNS]
        if any(found):
            wide.append([f"ours: {name}", *(None if a is None else f"{100 * a.share:.2f}" for a in found)])
    wide += [[f"{system(row)} (published)", *(row[column] for column in COLUMNS)] for row in printed("table2")]
    details = [
        {"attack": COLUMNS.get(column, column), "on": name, "of": of}
        for on, reading, name in WAYS
        for column in (*COLUMNS, *CUTS)
        if (of := picked(rows, on=on, reading=reading, attack=column))
    ]
    ours = table(
        details,
        "attack",
        "on",
        ("bits", lambda line: str(accuracy(line["of"]))),
        ("z, least to most", lambda line: range_text([row["z"] for row in line["of"]])),
        ("claims at 1e-9", lambda line: f"{sum(row['claimed'] for row in line['of'])} of {len(line['of'])}"),
        ("by the paper's rule (Eq 10)", lambda line: _by_eq10(line["of"])),
        title="Ours in full",
    )
    return Section(
        "Table 2: 32 bits after attacks",
        [
            "The paper names attacks without saying what they are run on or how strong they are; here is every "
            "reading. Pictures: one a reading, from views that are not the key views, camera known.",
            INTERVALS,
            PUBLISHED,
        ],
        [
            Table(("system", *COLUMNS.values()), wide, "Bit accuracy, %"),
            ours,
            Table(("attack", "picture, literal", "picture, as public code runs it", "model"), MEANINGS, "What is run"),
        ],
        [
            Drawing(
                "table2",
                lambda: draw(rows),
                "Bit accuracy after each attack of Table 2. Ours: informed, error bars exact 95 % over all bits. "
                "Others: published, other hardware and scenes, blind; HiDDeN+3DGS (47 to 58 %) lies left of the "
                "axis.",
            )
        ],
    )


def _found(rows: list[Row], on: str, reading: str, column: str) -> Accuracy | None:
    return accuracy(picked(rows, on=on, reading=reading, attack=column))


def _by_eq10(rows: list[Row]) -> str:
    return f"{100 * sum(row['right_by_eq10'] for row in rows) / sum(row['bits'] for row in rows):.2f} %"


def bars(rows: list[Row], options: Options) -> list[Bar]:
    """DESIGN 12: pictures 99.9 %, models 100 %, a tenth of the model 99.9 %."""
    wanted = [("picture", column, 0.999) for column in ("rotation", "scaling", "crop", "jpeg", "noise")]
    wanted += [("model", column, 1.0) for column in ("clone", "prune", "noise")]
    wanted += [("model", column, 0.999) for column in CUTS]
    made = []
    for on, column, least in wanted:
        for reading in ("literal", "as_code"):
            found = _found(rows, on, reading, column)
            if found is not None:
                what = f"32 bits, {on}, {COLUMNS.get(column, column)}"
                what += ", as public code runs it" if reading == "as_code" else ""
                bar = "100 %" if least == 1.0 else f">= {100 * least:g} %"
                made.append(Bar(what, bar, str(found), found.share >= least))
    return made


def draw(rows: list[Row]) -> Figure:
    """One line an attack, one mark a system."""
    drawn, axes = figure(width=7.6, height=4.8)
    ways = [(on, reading, name) for on, reading, name in WAYS if picked(rows, on=on, reading=reading)]
    for slot, ((on, reading, name), look) in enumerate(zip(ways, styles(), strict=False)):
        points = [(n, found) for n, column in enumerate(COLUMNS) if (found := _found(rows, on, reading, column))]
        axes.errorbar(
            [100 * found.share for _, found in points],
            [number - 0.26 + 0.14 * slot for number, _ in points],
            xerr=list(zip(*(found.error for _, found in points), strict=True)),
            label=f"ours, {name}",
            capsize=2,
            **look | {"linestyle": "none", "markersize": 6.5, "zorder": 5},
        )
    for mark, row in zip("xo+d*", [r for r in printed("table2") if r["system"] != "HiDDeN+3DGS"], strict=True):
        axes.plot(
            [row[column] for column in COLUMNS],
            [n + 0.34 for n in range(len(COLUMNS))],
            linestyle="none",
            marker=mark,
            color="#1a1a1a" if row["system"] == "Mark3DGS" else "#8a8a8a",
            markerfacecolor="none",
            label=system(row),
        )
    axes.set_yticks(range(len(COLUMNS)), list(COLUMNS.values()))
    axes.invert_yaxis()
    axes.set(xlim=(84, 101), xlabel="bit accuracy, %", title=_finding(rows))
    handles, labels = axes.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda k: not labels[k].startswith("ours"))
    drawn.legend([handles[k] for k in order], [labels[k] for k in order], loc="outside lower center", ncols=3)
    return drawn


def _finding(rows: list[Row]) -> str:
    of = [row for row in rows if row.get("attack") in COLUMNS and "on" in row]
    found = accuracy(of)
    if found is None or {row["attack"] for row in of} != set(COLUMNS):
        return "Bits after attacks"
    if found.share == 1.0:
        return "Every bit is read after every attack, in every reading of it"
    return f"{100 * found.share:.2f} % of bits are read over all attacks and readings"


PART = Part(
    "table2",
    "Table 2: bits after attacks",
    "How many of 32 bits are read after each of the paper's attacks?",
    cells,
    section,
    bars,
)
