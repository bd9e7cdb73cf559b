"""Table 5: fine-tuning in four settings."""

from engine.lab.evaluate.figures import Figure, figure, styles
from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.marked_scene import Changes
from engine.lab.evaluate.study import Bar, Cell, Drawing, Options, Row, Section
from engine.lab.evaluate.summary import picked, table
from engine.lab.evaluate.tables.part import PROFILE, PUBLISHED, Part, changes_of, printed, printed_table, scenes_of

SETTINGS = {
    "key": "marked pictures, key poses",
    "neither": "marked pictures, own poses",
    "clean+key": "clean pictures, key poses",
    "clean": "clean pictures, own poses",
}
BITS, LEAST, EPOCHS = 32, 0.999, 500
SIZE = 400
"""Side of the pictures the attacker trains on, pixels."""


def cells(options: Options) -> list[Cell]:
    """One training for each setting and scene."""
    return [
        Cell(
            f"table5-{setting.replace('+', '-and-')}-{short}",
            *training(path, setting, options, PROFILE, changes_of(options)),
        )
        for short, path in scenes_of(options)
        for setting in (("clean+key",) if options.quick else SETTINGS)
    ]


def training(
    path: str, setting: str, options: Options, profile: str, changes: Changes
) -> tuple[str, dict[str, str | int | Changes]]:
    """Function and arguments of a cell: one training of a scene marked by a profile with these changes."""
    epochs, size = (2, 200) if options.quick else (EPOCHS, SIZE)
    shared: dict[str, str | int | Changes] = {"seed": options.seed, "epochs": epochs, "size": size, "changes": changes}
    work = "engine.lab.evaluate.bench.training:measure_fine_tuning"
    return work, {"scene": path, "setting": setting, "profile": profile, **shared}


def section(rows: list[Row], options: Options) -> Section:
    """Bits, z, and what the training did to the model."""
    of = _own(rows)
    paper = {row["setting"]: row for row in printed("table5")}
    had = ("the attacker has", lambda row: SETTINGS[row["setting"]])
    ours = table(
        of,
        "scene",
        had,
        "epochs",
        ("bits", _share),
        ("the paper, %", lambda row: paper[row["setting"]].get(str(row["epochs"]))),
        "z",
        ("log10 false claim", "{log10_false_claim:.0f}"),
        "verdict",
        ("PSNR to clean, dB", "psnr_to_clean"),
        title="Ours",
    )
    theirs = printed_table(
        "table5", had, ("0 epochs", "0"), "100", "300", "500", title="Bit accuracy as the paper prints it, %"
    )
    return Section(
        "Table 5: fine-tuning",
        [
            "All parameters, at INRIA's rates, on the marked model; an epoch shows every picture once. 'Clean' "
            "pictures are renders of the unmarked model, the best that an attacker could have; 'key poses' are "
            "the owner's secret views. Bits are read from the model. One training each: its bits are not "
            "independent, the exact interval over them is too narrow.",
            PUBLISHED,
        ],
        [ours, theirs],
        [
            Drawing(
                "table5",
                lambda: draw(of),
                "Bit accuracy along fine-tuning, and the strength of our claim. Ours: informed, lowest scene; "
                "the paper: published, other hardware and scenes.",
            )
        ],
    )


def bars(rows: list[Row], options: Options) -> list[Bar]:
    """At least 99.9 % after the last epoch, in every setting."""
    made = []
    for setting, name in SETTINGS.items():
        what, wanted = f"{EPOCHS} epochs, {name}", f">= {100 * LEAST:g} %"
        last = picked(_own(rows), setting=setting, epochs=EPOCHS)
        if last:
            worst = min(last, key=lambda row: (row["bit_accuracy"], row["z"]))
            said = f"{_share(worst)}, z {worst['z']:.0f}, lowest of {len(last)} scenes"
            made.append(Bar(what, wanted, said, worst["bit_accuracy"] >= LEAST))
        else:
            made.append(Bar(what, wanted, "not run", None))
    return made


def draw(rows: list[Row]) -> Figure:
    """Bits of both on the left, our z on the right."""
    drawn, (left, right) = figure(1, 2, width=8.6, height=3.6)
    paper = {row["setting"]: row for row in printed("table5")}
    for (setting, name), look in zip(SETTINGS.items(), styles(), strict=False):
        of = picked(rows, setting=setting)
        epochs = sorted({row["epochs"] for row in of})
        worst = [min((row for row in of if row["epochs"] == e), key=lambda row: float(row["z"])) for e in epochs]
        stops = [int(name) for name in paper[setting] if name != "setting"]
        published = [paper[setting][str(stop)] for stop in stops]
        left.plot(
            stops, published, label=f"the paper: {name}", **{**look, "markerfacecolor": "white", "linewidth": 1.0}
        )
        if worst:
            left.plot(epochs, [100 * row["bit_accuracy"] for row in worst], **{**look, "linestyle": "none"}, zorder=5)
            right.plot(epochs, [row["z"] for row in worst], label=f"ours: {name}", **look)
    whole = "All bits survive in all four settings" if _all_whole(rows) else "Bits along fine-tuning"
    left.set(title=whole, xlabel="epochs", ylabel="bit accuracy, %", ylim=(45, 103))
    right.set(title="What is left of our claim", xlabel="epochs", ylabel="z of the claim")
    right.set_ylim(bottom=0)
    handles = [h + k for h, k in zip(left.get_legend_handles_labels(), right.get_legend_handles_labels(), strict=True)]
    drawn.legend(*handles, loc="outside lower center", ncols=2)
    return drawn


def _own(rows: list[Row]) -> list[Row]:
    return [row for row in rows if "epochs" in row and row.get("setting") in SETTINGS]


def _all_whole(rows: list[Row]) -> bool:
    return {row["setting"] for row in rows} == set(SETTINGS) and all(row["bit_accuracy"] == 1.0 for row in rows)


def _share(row: Row) -> str:
    low, high = share_interval(round(row["bit_accuracy"] * BITS), BITS)
    return f"{100 * row['bit_accuracy']:.2f} % ({100 * low:.1f} to {100 * high:.1f})"


PART = Part(
    "table5", "Table 5: fine-tuning", "Does fine-tuning on clean pictures wash the mark out?", cells, section, bars
)
