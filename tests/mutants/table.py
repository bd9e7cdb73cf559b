"""The table of mutations, and where its lines stand."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

TABLE = Path(__file__).with_name("table.toml")


@dataclass(frozen=True)
class Mutant:
    """A line of a file, by its text, what to put in its place, and the tests that should notice."""

    path: Path
    line: str
    changed: str
    tests: tuple[str, ...]

    @property
    def part(self) -> str:
        """What its score counts for: statistics, or the folder of the engine."""
        if self.path.stem == "statistics":
            return "statistics"
        return self.path.parts[1] if self.path.parts[0] == "engine" else self.path.parts[0]


def read_table() -> list[Mutant]:
    """All mutants, in the table's order."""
    table = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    return [
        Mutant(Path(entry["path"]), line, changed, tuple(entry["tests"]))
        for entry in table["file"]
        for line, changed in entry["mutants"]
    ]


def find(root: Path, mutant: Mutant) -> tuple[Path, int]:
    """File, relative to the root, and index of the line.

    Raises
    ------
    LookupError
        The line is nowhere, or in several places: the table must follow the code.
    """
    named = _places(root, mutant.path, mutant.line) if (root / mutant.path).is_file() else []
    others = (path.relative_to(root) for path in sorted((root / "engine").rglob("*.py")))
    found = named or [place for path in others for place in _places(root, path, mutant.line)]
    if len(found) != 1:
        raise LookupError(f"{mutant.path}: {mutant.line!r} stands in {len(found)} places")
    return found[0]


def mutated(root: Path, mutant: Mutant) -> tuple[Path, str]:
    """The file, relative to the root, and its text with the line changed."""
    path, index = find(root, mutant)
    lines = list(_lines(root / path))
    margin = len(lines[index]) - len(lines[index].lstrip())
    lines[index] = " " * margin + mutant.changed
    return path, "\n".join(lines)


def _places(root: Path, path: Path, code: str) -> list[tuple[Path, int]]:
    return [(path, index) for index in _indices(root / path).get(code, ())]


@cache
def _indices(path: Path) -> dict[str, list[int]]:
    """Where each line stands, without its comment."""
    places: dict[str, list[int]] = {}
    for index, line in enumerate(_lines(path)):
        places.setdefault(line.split("  # ")[0].strip(), []).append(index)
    return places


@cache
def _lines(path: Path) -> tuple[str, ...]:
    return tuple(path.read_text(encoding="utf-8").split("\n"))
