"""Strict reading of TOML tables: every value has a type and a range, and unknown names are errors.

Each field of a dataclass says how its value is read, `views: int = given(Table.integer, 100, 1, 10_000)`, and
`Table.read` makes one.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, fields
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from engine.errors import InputError

MAX_BYTES = 1 << 20  # a scenario is written by a person; anything larger is no scenario
LEAST_SIDE = 64  # of a picture, pixels

P = ParamSpec("P")
T = TypeVar("T")


def given(read: Callable[Concatenate[Table, str, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
    """A field of a dataclass, read from the table's value of the same name with these defaults and limits."""
    made: T = field(metadata={given: lambda table, name: read(table, name, *args, **kwargs)})
    return made


def read_table(path: Path) -> Table:
    """The top table of a TOML file; InputError naming file and line where it is none."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read the scenario {str(path)!r}: {error.strerror}") from error
    if len(data) > MAX_BYTES:
        raise InputError(f"{str(path)!r} has {len(data)} bytes; a scenario has at most {MAX_BYTES}")
    try:
        return Table(tomllib.loads(data.decode()), str(path), path.parent)
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{str(path)!r} is no TOML: {error}") from error


class Table:
    """One TOML table and its place in the file, as errors name it: `fall.toml: steps[2]`.

    `done` refuses names that were not read; names of other files are relative to `folder`.
    """

    def __init__(self, values: Mapping[str, Any], place: str, folder: Path) -> None:
        self.place = place
        self.folder = folder
        self.values = values
        self._known: set[str] = set()

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def done(self) -> None:
        """Refuse names that no field has read."""
        for name in self.values:
            if name not in self._known:
                near = difflib.get_close_matches(name, self._known, 1)
                hint = f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(sorted(self._known))}"
                raise InputError(f"{self.place}: {name!r} is not known here{hint}")

    def read(self, kind: type[T]) -> T:
        """A dataclass, all of whose fields are `given`, in their order."""
        known = fields(kind)  # type: ignore[arg-type]  # no type says "some dataclass"
        return kind(**{one.name: one.metadata[given](self, one.name) for one in known})

    def text(self, name: str, default: str | None = None, choices: Sequence[str] = ()) -> str:
        """A string, of `choices` where given."""
        value = self._take(name, default, str, "a string")
        if choices and value not in choices:
            raise InputError(f"{self.place}: {name} is one of {', '.join(choices)}; got {value!r}")
        return str(value)

    def flag(self, name: str, default: bool) -> bool:
        """True or false."""
        return bool(self._take(name, default, bool, "true or false"))

    def integer(self, name: str, default: int | None, low: int, high: int) -> int:
        """An integer in low..high."""
        value = int(self._take(name, default, int, "an integer"))
        if not low <= value <= high:
            raise InputError(f"{self.place}: {name} must lie in {low}..{high}, got {value}")
        return value

    def number(self, name: str, default: float | None, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number in low..high."""
        return self._number(name, self._take(name, default, (int, float), "a number"), low, high)

    def vector(self, name: str, default: Sequence[float] | None, size: int = 3) -> tuple[float, ...]:
        """A list of `size` finite numbers."""
        value = self._take(name, default, (list, tuple), f"a list of {size} numbers")
        if len(value) != size or not all(_is_number(v) for v in value):
            raise InputError(f"{self.place}: {name} must be a list of {size} numbers, got {value!r}")
        return tuple(self._number(name, v) for v in value)

    def size(self, name: str, default: tuple[int, int], largest: tuple[int, int]) -> tuple[int, int]:
        """Width and height of pictures, pixels."""
        width, height = (int(side) for side in self.vector(name, default, 2))
        if not (LEAST_SIDE <= width <= largest[0] and LEAST_SIDE <= height <= largest[1]):
            limits = " by ".join(f"{LEAST_SIDE}..{side}" for side in largest)
            raise InputError(f"{self.place}: {name} must lie in {limits}, got {width}x{height}")
        return width, height

    def file(self, name: str) -> Path:
        """An existing file."""
        path = self.folder / self.text(name)
        if not path.exists():
            raise InputError(f"{self.place}: {name}: there is no file {str(path)!r}")
        return path

    def strength(self, name: str) -> float | str | None:
        """A number or a word, or None where not given."""
        if name not in self:
            self._known.add(name)
            return None
        value = self._take(name, None, (int, float, str), "a number or a word")
        return value if isinstance(value, str) else float(value)

    def table(self, name: str) -> Table | None:
        """A table inside, or None where not given."""
        self._known.add(name)
        if name not in self:
            return None
        return Table(self._take(name, None, dict, "a table"), f"{self.place}: {name}", self.folder)

    def tables(self, name: str) -> list[Table]:
        """A list of tables; empty where not given."""
        value = self._take(name, [], list, "a list of tables")
        if not all(isinstance(entry, dict) for entry in value):
            raise InputError(f"{self.place}: {name} must be a list of tables")
        return [Table(entry, f"{self.place}: {name}[{k + 1}]", self.folder) for k, entry in enumerate(value)]

    def pairs(self, name: str) -> tuple[tuple[str, float | str | None], ...]:
        """A list of names with strengths: `["blur", ["jpeg", 30]]`."""
        found: list[tuple[str, float | str | None]] = []
        for entry in self._take(name, [], list, "a list of attacks"):
            parts = entry if isinstance(entry, list) else [entry]
            fits = len(parts) in (1, 2) and isinstance(parts[0], str)
            if not fits or not (len(parts) == 1 or _is_number(parts[1]) or isinstance(parts[1], str)):
                raise InputError(f"{self.place}: {name} holds names or [name, strength]; got {entry!r}")
            found.append((parts[0], parts[1] if len(parts) == 2 else None))
        return tuple(found)

    def _take(self, name: str, default: Any, kind: type | tuple[type, ...], what: str) -> Any:
        self._known.add(name)
        if name not in self.values:
            if default is None:
                raise InputError(f"{self.place}: {name} is missing; it is {what}")
            return default
        value = self.values[name]
        # A bool is an int to Python, not to a person.
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise InputError(f"{self.place}: {name} must be {what}, got {value!r}")
        return value

    def _number(self, name: str, value: Any, low: float = -math.inf, high: float = math.inf) -> float:
        if not (math.isfinite(value) and low <= value <= high):
            raise InputError(f"{self.place}: {name} must be a finite number in {low}..{high}, got {value}")
        return float(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
