"""What is swept: every attack of the simulator in every reading, its strengths in order from harmless to ruinous."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from engine.sim.attack import Label, Strength
from engine.sim.attacks import IMAGE_ATTACKS, MODEL_ATTACKS

__all__ = ["Sweep", "all_sweeps", "branches", "thinned"]

STEPS = 5
"""Strengths of one sweep, at most; its grid's ends are always among them."""
LEFT_OUT = ("transplant",)
"""Frames another model and removes nothing: the study `null` has it."""


@dataclass(frozen=True)
class Sweep:
    """One attack, in one reading and one direction, over its strengths.

    Parameters
    ----------
    attack : str
        Of `engine.sim.attacks`.
    kind : {"model", "image"}
    reading : {"literal", "as_code"}
    direction : {"", "down", "up"}
        Which side of the neutral strength, for attacks that have two.
    strengths : tuple of float or str
        From harmless to ruinous; names are kinds and have no order.
    meaning : str
        Unit and meaning of the strength.
    """

    attack: str
    kind: Literal["model", "image"]
    reading: Label
    direction: str
    strengths: tuple[Strength, ...]
    meaning: str

    @property
    def name(self) -> str:
        """In tables, figures and names of cells."""
        parts = [self.attack, self.direction, "as_code" if self.reading == "as_code" else ""]
        return "-".join(part for part in parts if part)


def all_sweeps() -> list[Sweep]:
    """Every attack but those that remove nothing, every reading, each side of the neutral strength."""
    sweeps = []
    attacks: list[Any] = [*MODEL_ATTACKS.values(), *IMAGE_ATTACKS.values()]
    for attack in attacks:
        if attack.name in LEFT_OUT:
            continue
        for reading in attack.readings:
            for direction, strengths in branches(reading.grid).items():
                sweeps.append(
                    Sweep(attack.name, attack.kind, reading.label, direction, thinned(strengths), reading.meaning)
                )
    return sweeps


def branches(grid: tuple[Strength, ...]) -> dict[str, tuple[Strength, ...]]:
    """A grid as one or two runs of strengths from harmless to ruinous.

    Grids that go to both sides alternate: factors about 1, and signed strengths about 0.
    """
    numbers = [value for value in grid if not isinstance(value, str)]
    if len(numbers) < len(grid):
        return {"": grid}
    steps = np.diff(numbers)
    if (steps > 0).all() or (steps < 0).all():
        return {"": grid}
    neutral = 0.0 if min(numbers) < 0 else 1.0
    return {
        "down": tuple(sorted((v for v in numbers if v < neutral), reverse=True)),
        "up": tuple(sorted(v for v in numbers if v > neutral)),
    }


def thinned(strengths: tuple[Strength, ...], most: int = STEPS) -> tuple[Strength, ...]:
    """At most so many of them, evenly spread, both ends kept. Kinds (names) all stay."""
    if any(isinstance(value, str) for value in strengths) or len(strengths) <= most:
        return strengths
    return tuple(strengths[round(k)] for k in np.linspace(0, len(strengths) - 1, most))
