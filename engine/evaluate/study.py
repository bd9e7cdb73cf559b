"""What an evaluation is made of: cells that measure, bars to reach, sections to read.

A study is a list of cells. A cell names a function and plain arguments, so that it can run in any process, on any
machine, and be looked up when a study goes on after a break. What cells return is plain rows; the report is made of
all rows together and of nothing else.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from typing import TYPE_CHECKING, Any

from engine.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = dict[str, Any]
"""Plain JSON values."""

__all__ = ["Bar", "Cell", "Drawing", "Options", "Report", "Row", "Section", "Study", "Table"]


@dataclass(frozen=True)
class Options:
    """What a study may be asked for.

    Parameters
    ----------
    scenes : tuple of str
        Paths of models; the first one is the study's main scene.
    quick : bool
        A few cells of each kind: tells in a minute or so that everything runs, not how well.
    lpips_weights : str or None
        File with the weights of LPIPS, for studies that can use them.
    """

    scenes: tuple[str, ...]
    quick: bool = False
    seed: int = 0
    lpips_weights: str | None = None


@dataclass(frozen=True)
class Cell:
    """One measurement, the unit that is run, stored and resumed.

    Parameters
    ----------
    name : str
        Unique in the study; letters, digits, ``. - _``.
    work : str
        ``"package.module:function"``; called with the arguments, returns a list of rows.
    arguments : dict
        JSON values.
    """

    name: str
    work: str
    arguments: dict[str, Any]

    def __post_init__(self) -> None:
        if not self.name or not all(c.isalnum() or c in ".-_" for c in self.name):
            raise InputError(f"the name of a cell is made of letters, digits, '.', '-' and '_', got {self.name!r}")

    @property
    def digest(self) -> str:
        """Of what is to be done: a stored result belongs to it or is stale."""
        said = json.dumps([self.work, self.arguments], sort_keys=True, allow_nan=False)
        return sha256(said.encode()).hexdigest()[:16]

    def run(self) -> list[Row]:
        """Measure, here and now."""
        module, _, function = self.work.partition(":")
        rows: list[Row] = getattr(importlib.import_module(module), function)(**self.arguments)
        return rows


@dataclass(frozen=True)
class Bar:
    """Something that was promised, and what was measured.

    Parameters
    ----------
    wanted : str
        In words and numbers: ``">= 99.9 %"``.
    measured : str
        With its interval.
    met : bool or None
        None: could not be measured in this run.
    """

    what: str
    wanted: str
    measured: str
    met: bool | None


@dataclass(frozen=True)
class Table:
    """Columns and rows of text or numbers, shown as they are.

    Parameters
    ----------
    columns : sequence of str
    rows : sequence of sequence
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    title: str = ""


@dataclass(frozen=True)
class Drawing:
    """A figure by name; made only when a report is written.

    Parameters
    ----------
    name : str
        Of its files.
    make : callable
        Gives a matplotlib Figure (see `engine.evaluate.drawing`).
    """

    name: str
    make: Callable[[], Figure]
    caption: str


@dataclass(frozen=True)
class Section:
    """A heading and what stands below it: paragraphs, then tables and drawings."""

    title: str
    text: Sequence[str] = ()
    tables: Sequence[Table] = ()
    drawings: Sequence[Drawing] = ()


@dataclass(frozen=True)
class Report:
    """What all rows together say.

    Parameters
    ----------
    bars : sequence of Bar
        The report lists those that were missed first.
    sections : sequence of Section
    answer : sequence of str
        Paragraphs before everything else: what a reader came for.
    summary : dict
        Further results as JSON values.
    """

    bars: Sequence[Bar]
    sections: Sequence[Section]
    answer: Sequence[str] = ()
    summary: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """One of `mark3dgs evaluate`'s suites.

    Parameters
    ----------
    name, title, question : str
        The question is what the study answers, in one sentence.
    cells : callable
        Options -> list of Cell, in the order they are best run.
    report : callable
        (rows, options) -> Report; rows are those of all cells, each with its ``"cell"``.
    """

    name: str
    title: str
    question: str
    cells: Callable[[Options], list[Cell]]
    report: Callable[[list[Row], Options], Report]
