"""A table or figure of the study: the cells it needs, and what their rows say."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from engine.evaluate.study import Bar, Cell, Options, Row, Section
from engine.evaluate.tables.effort import Effort, scenes_of
from engine.evaluate.tables.setting import Setting

__all__ = ["CELLS", "Part", "of_kind", "setting_cells"]

CELLS = "engine.evaluate.tables.cells"
"""Package of the cells' functions."""


@dataclass(frozen=True)
class Part:
    """One of the suites that the tables are made of.

    Parameters
    ----------
    name : str
        ``table1`` ...
    cells : callable
        Options -> cells; parts may share cells, which are then run once.
    section : callable
        (rows, options) -> Section, from rows of all parts.
    bars : callable
        (rows, options) -> bars.
    """

    name: str
    title: str
    question: str
    cells: Callable[[Options], list[Cell]]
    section: Callable[[list[Row], Options], Section]
    bars: Callable[[list[Row], Options], list[Bar]] = lambda rows, options: []


def setting_cells(options: Options, settings: Iterable[Setting], *, sweep: bool = True) -> list[Cell]:
    """One cell for each setting, scene and key.

    In a sweep, pictures are fewer and smaller, and each is read after every attack of `settings.ATTACKS`.
    """
    effort = Effort.of(options)
    keys, views, size = (
        (effort.sweep_keys, effort.sweep_views, effort.sweep_size)
        if sweep
        else (effort.keys, effort.views, effort.size)
    )
    return [
        Cell(
            f"set-{setting.name}-{short}-k{seed}",
            f"{CELLS}.settings:measure_setting",
            {
                "scene": path,
                "setting": setting.to_json(),
                "seed": seed,
                "views": views,
                "size": size,
                "changes": effort.changes,
                "attacked": sweep,
            },
        )
        for setting in settings
        for short, path in scenes_of(options)
        for seed in range(options.seed, options.seed + keys)
    ]


def of_kind(rows: Iterable[Row], **wanted: object) -> list[Row]:
    """Rows that hold all these values."""
    return [row for row in rows if all(name in row and row[name] == value for name, value in wanted.items())]
