"""A table or figure of the study: the settings and cells it needs, what the paper prints in it."""

import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TypedDict

from engine.lab.evaluate.marked_scene import Changes
from engine.lab.evaluate.study import Bar, Cell, Options, Row
from engine.lab.evaluate.summary import grouped, picked

PROFILE = "fast"
"""Profile that a setting starts from: the cheapest one, so nothing shown here needs more."""
MEASURING = "engine.lab.evaluate.tables.tables_cells"
"""Module of the cells' functions, where no bench has the same."""
KINDS = ("marked", "refused", "view", "picture")
"""Of the rows of a setting's cell."""


@dataclass(frozen=True)
class Part:
    """One of the suites that the tables are made of; parts may share cells, and each is given the rows of all."""

    name: str
    tables: tuple[str, ...]  # whose lines it fills, see `facing`
    cells: Callable[[Options], list[Cell]]
    bars: Callable[[list[Row], Options], list[Bar]] = lambda rows, options: []


@dataclass(frozen=True)
class Setting:
    """A way to mark a scene, as plain values; its name, unique among all tables, names cells."""

    name: str
    changes: Changes = field(default_factory=dict)
    """Fields of `EmbedConfig` that differ from the profile's, nested as its stages are."""
    bits: int = 32
    unmarked: bool = False
    """Look at the unmarked original in place of the marked model."""
    profile: str = PROFILE


DEFAULT = Setting("default")
"""The profile as it is, 32 bits."""


@dataclass(frozen=True)
class Effort:
    """Owner keys that every scene is marked under (pose keys, chips and messages follow); pictures of a marked model,
    from views that are not the key views; and their side, 176 pixels at least."""

    keys: int
    views: int
    size: int


def efforts(options: Options) -> tuple[Effort, Effort]:
    """Of this run's single settings, and of its sweeps, where one knob is turned after the other."""
    return (Effort(1, 1, 256), Effort(1, 1, 192)) if options.quick else (Effort(3, 4, 800), Effort(2, 3, 480))


def changes_of(options: Options) -> Changes:
    """What differs from the profile in every embedding of this run; cameras are given, so there are no landmarks."""
    return {"landmark_views": 0, **({"views": 2, "view_size": 256} if options.quick else {})}


def scenes_of(options: Options) -> Iterator[tuple[str, str]]:
    """A short name for cells, and the path, of each scene."""
    for number, path in enumerate(options.scenes):
        safe = "".join(c if c.isalnum() else "_" for c in Path(path).name.split(".")[0])
        yield f"{safe}{number}", path


def setting_cells(options: Options, settings: Iterable[Setting], *, sweep: bool = True) -> list[Cell]:
    """One cell for each setting, scene and key.

    In a sweep, pictures are fewer and smaller, and each is read after every attack of `tables_cells.ATTACKS`.
    """
    effort = efforts(options)[sweep]
    shared = {"views": effort.views, "size": effort.size, "changes": changes_of(options), "attacked": sweep}
    return [
        Cell(
            f"set-{setting.name}-{short}-k{seed}",
            f"{MEASURING}:measure_setting",
            {"scene": path, "setting": asdict(setting), "seed": seed, **shared},
        )
        for setting in {setting.name: setting for setting in settings}.values()
        for short, path in scenes_of(options)
        for seed in range(options.seed, options.seed + effort.keys)
    ]


def rows_of_setting(rows: Iterable[Row], name: str) -> dict[str, list[Row]]:
    """A setting's rows by kind (see `tables_cells.measure_setting`); lists are empty where there is none."""
    found = grouped(picked(rows, setting=name), "kind")
    return {kind: found.get(kind, []) for kind in KINDS}


class PrintedTable(TypedDict):
    """One of the paper's tables as the file has it."""

    columns: list[str]
    rows: list[list[str | float]]  # "-" where the paper prints nothing


@cache
def _paper() -> Mapping[str, PrintedTable]:
    found: Mapping[str, PrintedTable] = tomllib.loads(files(__package__).joinpath("paper.toml").read_text())
    return found


def printed(name: str) -> list[Row]:
    """Rows of one of the paper's tables, each a dict by column; what it does not print is None."""
    found = _paper()[name]
    return [
        {name: None if value == "-" else value for name, value in zip(found["columns"], row, strict=True)}
        for row in found["rows"]
    ]
