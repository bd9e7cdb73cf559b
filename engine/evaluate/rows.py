"""Rows of a study, picked, grouped and shown: the few moves that every report is made of."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from engine.evaluate.study import Row, Table

__all__ = ["as_named", "distinct", "grouped", "listed", "picked", "tabled"]


def picked(rows: Iterable[Row], **wanted: Any) -> list[Row]:
    """Those rows whose fields have these values."""
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


def tabled(rows: Iterable[Row], columns: Mapping[str, str | Callable[[Row], Any]], title: str = "") -> Table:
    """A table with one line a row.

    Parameters
    ----------
    columns : mapping
        Heading -> field's name (nothing where a row has none), format over the fields (``"{low:.1f} to {high:.1f}"``),
        or function of the row.
    """
    return Table(list(columns), [[_shown(row, what) for what in columns.values()] for row in rows], title)


def as_named(*fields: str) -> dict[str, str]:
    """Columns for `tabled` that are headed as the fields are called."""
    return {name: name for name in fields}


def listed(lines: Sequence[Row], title: str = "") -> Table:
    """A table of ready-made lines, all with the same headings as keys."""
    return Table(list(lines[0]) if lines else [], [list(line.values()) for line in lines], title)


def _shown(row: Row, what: str | Callable[[Row], Any]) -> Any:
    if callable(what):
        return what(row)
    return what.format_map(row) if "{" in what else row.get(what)
