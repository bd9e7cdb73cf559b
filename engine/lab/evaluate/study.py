"""What an evaluation is made of: cells that measure, bars to reach, sections to read.

A study is a list of cells. A cell names a function and plain arguments, so that it can run in any process, on any
machine, and be looked up when a study continues after a break. What cells return is plain rows; the report is made of
all rows together and of nothing else (`engine.lab.evaluate.rows` picks, groups and tabulates them).
"""

import importlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any, Self

from engine.errors import InputError
from engine.lab.evaluate.figures import Figure

Row = dict[str, Any]
"""Plain JSON values."""

__all__ = ["Bar", "Cell", "Drawing", "Options", "Report", "Row", "Section", "Study", "Table"]


@dataclass(frozen=True)
class Options:
    """What a suite is run with; which of the optional ones it knows stands in `Study.knows`."""

    scenes: tuple[str, ...]  # paths of models; the first one is the study's main scene
    quick: bool = False  # a few cells of each kind: tells in a minute or so that everything runs, not how well
    seed: int = 0
    lpips_weights: str | None = None  # file with the weights of LPIPS
    settings: tuple[str, ...] = ()  # parts of the suite by name; empty: all
    profile: str = "fast"
    trials: int | None = None  # None: the suite's own number
    device: str = "cpu"  # that fits what pruning leaves
    methods: tuple[str, ...] = ()  # under test, by name or as module:Class; empty: ours


@dataclass(frozen=True)
class Cell:
    """One measurement, the unit that is run, stored and resumed."""

    name: str  # unique in the study; letters, digits, . - _
    work: str  # "package.module:function"; called with the arguments, returns a list of rows
    arguments: dict[str, Any]  # JSON values

    def __post_init__(self) -> None:
        if not self.name or not all(c.isalnum() or c in ".-_" for c in self.name):
            raise InputError(f"the name of a cell is made of letters, digits, '.', '-' and '_', got {self.name!r}")

    @classmethod
    def of(cls, name: str, work: Callable[..., list[Row]], /, **arguments: Any) -> Self:
        """The cell that calls a function of a module with these arguments."""
        return cls(name, f"{work.__module__}:{work.__qualname__}", arguments)

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
    """Something that was promised, and what was measured."""

    what: str
    wanted: str  # in words and numbers: ">= 99.9 %"
    measured: str  # with its interval
    met: bool | None  # None: could not be measured in this run

    @classmethod
    def without(cls, what: str, wanted: str, measured: str, faults: Sequence[str]) -> Self:
        """Met where there are no faults; they are listed behind what was measured."""
        return cls(what, wanted, "; ".join([measured, *faults]), not faults)


@dataclass(frozen=True)
class Table:
    """Columns and rows of text or numbers, shown as they are."""

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    title: str = ""


@dataclass(frozen=True)
class Drawing:
    """A figure by the name of its files; made only when a report is written, in the house style."""

    name: str
    make: Callable[[], Figure]
    caption: str


@dataclass(frozen=True)
class Section:
    """A heading and what stands below it: paragraphs, then drawings and tables."""

    title: str
    text: Sequence[str] = ()
    tables: Sequence[Table] = ()
    drawings: Sequence[Drawing] = ()


@dataclass(frozen=True)
class Report:
    """What all rows together say."""

    bars: Sequence[Bar]  # those that were missed are shown first
    sections: Sequence[Section]
    answer: Sequence[str] = ()  # paragraphs before everything else: what a reader came for
    summary: dict[str, Any] = field(default_factory=dict)  # further results as JSON values
    pages: dict[str, str] = field(default_factory=dict)  # further files next to the report, by name


@dataclass(frozen=True)
class Study:
    """One suite of `mark3dgs evaluate`; it answers one question."""

    name: str
    title: str
    question: str
    cells: Callable[[Options], list[Cell]]  # in the order they are best run
    report: Callable[[list[Row], Options], Report]  # rows are those of all cells, each with its "cell"
    knows: frozenset[str] = frozenset({"quick"})  # optional fields of `Options` that it takes into account
