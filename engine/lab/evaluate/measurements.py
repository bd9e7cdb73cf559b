"""Suites that print rows: a function of `bench` measured on every scene, without bars or figures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from engine.lab.evaluate.study import Cell, Options, Report, Row, Section, Study, Table

TRIALS = {"trials": 50, "innocents": 10_000, "assets": 1_000, "pictures": 200}
"""What `--trials` counts in each suite, and its default."""


@dataclass(frozen=True)
class Measurement:
    """One such suite: rows of a ``"module:function"`` of the package `bench`."""

    summary: str
    work: str
    reported: tuple[str, ...] = ("profile",)
    """Options that the function takes and the report repeats; those in TRIALS take their number from `--trials`."""
    scenes: Literal["each", "together", "with the next"] = "each"
    """A cell for each scene, or one for all; with `other`, the scene after it (None if it is the only one)."""

    def study(self, name: str) -> Study:
        """The suite as a study whose report is the table of its rows."""
        options = {"trials" if option in TRIALS else option for option in self.reported}
        return Study(
            name,
            self.summary[0].upper() + self.summary[1:],
            f"{self.summary[0].upper()}{self.summary[1:]}?",
            lambda given: self.cells(name, given),
            lambda rows, given: Report((), [_section(rows)], summary=self.conditions(given)),
            frozenset(options),
        )

    def conditions(self, options: Options) -> dict[str, Any]:
        """Options that the report repeats, with their values."""
        return {option: _value(option, options) for option in self.reported}

    def cells(self, name: str, options: Options) -> list[Cell]:
        """One cell a scene, or one for all."""
        shared = {name: _value(name, options) for name in self.reported} | {"seed": options.seed}
        work, scenes = f"engine.lab.evaluate.bench.{self.work}", list(options.scenes)
        if self.scenes == "together":
            return [Cell(name, work, {"scenes": scenes, **shared})]
        cells = []
        for number, (scene, after) in enumerate(zip(scenes, [*scenes[1:], scenes[0]], strict=True)):
            arguments = {"scene": scene, **shared}
            if self.scenes == "with the next":
                arguments["other"] = after if after != scene else None
            stem = "".join(letter if letter.isalnum() else "_" for letter in Path(scene).stem)
            cells.append(Cell(f"{name}-{number}-{stem}", work, arguments))
        return cells


def _value(option: str, options: Options) -> Any:
    if option in TRIALS:
        return options.trials or TRIALS[option]
    value = getattr(options, option)
    return list(value) if isinstance(value, tuple) else value


def _section(rows: Sequence[Row]) -> Section:
    """All rows in a table; columns in the order in which they first appear."""
    columns = list(dict.fromkeys(name for row in rows for name, value in row.items() if not isinstance(value, dict)))
    return Section("Measured", tables=[Table(columns, [[row.get(name, "") for name in columns] for row in rows])])


MEASUREMENTS = {
    "budgets": Measurement(
        "Gaussians, bytes, seconds, dB and z for pruning budgets and compact output, without and with recovery",
        "marking:measure_budgets",
        ("profile", "device"),
    ),
    "promises": Measurement(
        "what profile auto promises of one JPEG-10 picture and what three show, CPU seconds beside fast and balanced",
        "marking:measure_promises",
        (),
    ),
    "screenshots": Measurement(
        "claims from pictures of unknown camera, and from another scene's",
        "attacks:measure_screenshots",
        ("profile", "trials"),
        scenes="with the next",
    ),
    "foreign": Measurement(
        "pictures of the unmarked asset, of another scene, of lumps and photographs: claims and recognitions",
        "foreign:measure_foreign",
        ("profile", "pictures"),
        scenes="with the next",
    ),
    "collusion": Measurement(
        "collusion: which of the colluding buyers are named, and whether an innocent one is",
        "truth:measure_collusion",
        ("innocents", "settings"),
    ),
    "screening": Measurement(
        "which of many assets is it? ranks, seconds, bytes",
        "screening:measure_screening",
        ("assets",),
        scenes="together",
    ),
    "removal": Measurement("what it costs to take the mark out without a key, in decibels", "removal:measure_removal"),
}
