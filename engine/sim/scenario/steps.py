"""What a step is, and the list of all kinds of steps by the word that a scenario calls them with."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from engine.sim.scenario.tables import Table
from engine.sim.scenario.world import Advance, Outcome, World

__all__ = ["NamedStep", "Step", "StepKind", "all_kinds", "read_step"]


TELLING = ("name", "strength", "setting", "epochs", "views", "copies", "rule", "height", "share", "on")
"""Values that make up the label of a step without one."""


class Step(Protocol):
    """One thing that happens to a world."""

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        """Carry it out; the world given stays as it is."""
        ...


@dataclass(frozen=True)
class StepKind:
    """A kind of step: how its table is read, and one line for `mark3dgs sim --list`."""

    read: Callable[[Table], Step]
    summary: str


@dataclass(frozen=True)
class NamedStep:
    """A step with the words under which tables and pictures show it."""

    label: str
    step: Step


def read_step(table: Table) -> NamedStep:
    """The step that a table describes; InputError naming the place of what does not fit."""
    kinds = all_kinds()
    word = table.text("do", choices=tuple(kinds))
    label = table.text("label", "")
    step = kinds[word].read(table)
    table.done()
    told = [str(table.values[name]) for name in TELLING if name in table]
    return NamedStep(label or " ".join([word, *told]), step)


def all_kinds() -> Mapping[str, StepKind]:
    """Every kind of step; imported late, for `--help` stays quick."""
    from engine.sim.scenario import edit_steps, life_steps, theft_steps, training_steps

    return {**theft_steps.KINDS, **edit_steps.KINDS, **life_steps.KINDS, **training_steps.KINDS}
