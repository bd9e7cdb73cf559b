"""What rows add up to: rows picked by their values, shares of bits, tables of columns."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.study import Row, Table

BUSY = 1.5
"""Programs a core (`engine.lab.evaluate.machine.load_per_core`) from which on times are called too long."""

Column = str | tuple[str, str | Callable[[Any], Any]]
"""A key of the rows; or a heading with a key, a text with keys in braces, or a function of a row."""


def picked(rows: Iterable[Row], **wanted: object) -> list[Row]:
    """Those rows whose fields have these values; a field that is not there is None."""
    return [row for row in rows if all(row.get(name) == value for name, value in wanted.items())]


def grouped(rows: Iterable[Row], *fields: str) -> dict[Any, list[Row]]:
    """Rows by the value of a field (of several: by the tuple of their values), groups in the order they appear."""
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        key = tuple(row[name] for name in fields)
        groups.setdefault(key if len(fields) > 1 else key[0], []).append(row)
    return groups


def distinct(rows: Iterable[Row], *fields: str) -> list[Any]:
    """Keys of `grouped`."""
    return list(grouped(rows, *fields))


def scene_name(scene: str) -> str:
    """Of a scene's file: what stands before the first dot."""
    return Path(scene).name.partition(".")[0].replace(" ", "-")


def listed(lines: Sequence[Row], title: str = "") -> Table:
    """A table of ready-made lines, all with the same headings as keys."""
    return Table(list(lines[0]) if lines else [], [list(line.values()) for line in lines], title)


def table(rows: Iterable[Any], *columns: Column, title: str = "") -> Table:
    """One line for each row."""
    pairs = [(column, column) if isinstance(column, str) else column for column in columns]
    return Table([heading for heading, _ in pairs], [[_cell(row, what) for _, what in pairs] for row in rows], title)


def _cell(row: Any, what: str | Callable[[Any], Any]) -> Any:
    if callable(what):
        return what(row)
    return what.format_map(row) if "{" in what else row.get(what)


@dataclass(frozen=True)
class Accuracy:
    """Bits of several readings: the share read right (0 to 1) with its exact interval over bits, how many readings, how
    many without a wrong bit, and the lower end of the exact interval of that share."""

    share: float
    low: float
    high: float
    readings: int
    whole: int
    whole_low: float

    def __str__(self) -> str:
        return (
            f"{100 * self.share:.2f} % ({100 * self.low:.2f} to {100 * self.high:.2f}); "
            f"{self.whole} of {self.readings} readings whole (at least {100 * self.whole_low:.0f} %)"
        )


def accuracy(rows: Sequence[Row], right: str = "right") -> Accuracy | None:
    """Of rows with ``right`` and ``bits``; None without rows."""
    if not rows:
        return None
    bits, hits = sum(row["bits"] for row in rows), sum(row[right] for row in rows)
    whole = sum(row[right] == row["bits"] for row in rows)
    return Accuracy(hits / bits, *share_interval(hits, bits), len(rows), whole, share_interval(whole, len(rows))[0])


def busy_words(rows: Sequence[Row]) -> list[str]:
    """A paragraph where rows with a `busy` were measured during other work; none otherwise."""
    most = max((row.get("busy") or 0.0 for row in rows), default=0.0)
    if most <= BUSY:
        return []
    return [
        f"The machine was busy with other work (up to {most:.1f} programs a core): all seconds here are too long, and "
        "differences between settings in time are not to be trusted; processor time still is."
    ]
