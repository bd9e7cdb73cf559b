"""A scenario as it is written: objects, steps, how it is shown. Nothing is loaded or run here."""

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from engine.errors import InputError
from engine.lab.sim.scenario import audit_steps, capture_steps, edit_steps, matter_steps, theft_steps
from engine.lab.sim.scenario.sources import Part
from engine.lab.sim.scenario.state import Step
from engine.lab.sim.scenario.tables import Table, given, read_table

T = TypeVar("T")

MAX_STEPS = 200
MAX_OBJECTS = 64

KINDS = {
    **theft_steps.KINDS,
    **edit_steps.KINDS,
    **matter_steps.KINDS,
    **capture_steps.KINDS,
    **theft_steps.PATIENT,
    **audit_steps.KINDS,
}
"""Every kind of step, by the word that a scenario calls it with."""

LABELING = ("name", "strength", "setting", "epochs", "views", "copies", "rule", "height", "share", "time", "on")
"""Values that make up the label of a step without one."""


@dataclass(frozen=True)
class Film:
    """How the run is shown: pixels, frames a step (0: no film), frames a second."""

    size: tuple[int, int] = given(Table.size, (640, 480), (3840, 2160))
    frames: int = given(Table.integer, 16, 0, 1000)
    rate: float = given(Table.number, 12.0, 1.0, 60.0)


@dataclass(frozen=True)
class NamedStep:
    """A step with the words under which tables and pictures show it."""

    label: str
    step: Step


@dataclass(frozen=True)
class Scenario:
    """What happens, in order; the seed is that of the key and of every random choice."""

    title: str
    seed: int
    parts: tuple[Part, ...]
    steps: tuple[NamedStep, ...]
    film: Film


def read_scenario(path: str | Path) -> Scenario:
    """Read a TOML file; model paths in it are relative to its folder.

    InputError names file, table and value of the first thing that does not fit.
    """
    path = Path(path)
    top = read_table(path)
    parts = tuple(_whole(table, Part) for table in top.tables("objects"))
    if not 1 <= len(parts) <= MAX_OBJECTS:
        raise InputError(f"{path}: a scenario has 1 to {MAX_OBJECTS} [[objects]], got {len(parts)}")
    names = [part.name for part in parts]
    if len(set(names)) != len(names):
        raise InputError(f"{path}: two objects have the same name; got {', '.join(names)}")
    tables = top.tables("steps")
    if len(tables) > MAX_STEPS:
        raise InputError(f"{path}: a scenario has at most {MAX_STEPS} [[steps]], got {len(tables)}")
    scenario = Scenario(
        title=top.text("title", path.stem),
        seed=top.integer("seed", 0, 0, 2**63 - 1),
        parts=parts,
        steps=tuple(_step(table) for table in tables),
        film=_whole(top.table("film") or Table({}, f"{path}: film", path.parent), Film),
    )
    top.done()
    return scenario


def _whole(table: Table, kind: type[T]) -> T:
    """The dataclass that a table gives, nothing left over."""
    made = table.read(kind)
    table.done()
    return made


def _step(table: Table) -> NamedStep:
    word = table.text("do", choices=tuple(KINDS))
    label = table.text("label", "")
    step = _whole(table, KINDS[word].made)
    values = [str(table.values[name]) for name in LABELING if name in table]
    return NamedStep(label or " ".join([word, *values]), step)
