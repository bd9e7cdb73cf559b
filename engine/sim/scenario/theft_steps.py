"""Steps of thieves: attacks on models, pictures that turn up."""

from dataclasses import dataclass

import numpy as np

from engine.model import Float32
from engine.pipeline.rigs import make_rig
from engine.raster import render
from engine.sim.attack import Strength
from engine.sim.attacks import image_attack, model_attack
from engine.sim.cost import model_cost
from engine.sim.scenario.tables import Table, given
from engine.sim.scenario.world import Advance, Outcome, StepKind, World, step

__all__ = ["KINDS"]

KINDS: dict[str, StepKind] = {}

COST_VIEWS, COST_SIZE = 2, 300
"""Neutral views in which an attack's cost is measured, and their side in pixels."""


Link = tuple[str, Strength | None]
"""An attack's name and strength; None is its default."""


def read_attack(table: Table, name: str) -> str:
    """The name of an attack on models."""
    return model_attack(table.text(name)).name


def read_reading(table: Table, name: str) -> str | None:
    """One of the attack's readings, or None: its default."""
    readings = [reading.label for reading in model_attack(table.text("name")).readings]
    return table.text(name, "-", ("-", *readings)).replace("-", "") or None


def read_chain(table: Table, name: str) -> tuple[Link, ...]:
    """Attacks on pictures."""
    attacks = table.pairs(name)
    for attack, _ in attacks:
        image_attack(attack)  # an unknown one is refused before any work
    return attacks


@step(KINDS, "attack", "an attack on the model: name, strength, reading, on")
@dataclass(frozen=True)
class AttackModel:
    """An attack of the registry on the file, or on one object."""

    name: str = given(read_attack)
    reading: str | None = given(read_reading)
    strength: Strength | None = given(Table.strength)
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name, model = world.target(self.on)
        attacked = model_attack(self.name).apply(model, self.strength, rng=rng, reading=self.reading)
        cost = model_cost(model, attacked, views=COST_VIEWS, size=COST_SIZE)
        return Outcome(world.put(name, attacked), cost=cost)


@step(KINDS, "pictures", "only pictures turn up: views, size, attacks = [[name, strength]], known_cameras, on")
@dataclass(frozen=True)
class TakePictures:
    """Views that nobody planned, through a chain of image attacks; the world stays as it was."""

    attacks: tuple[Link, ...] = given(read_chain)
    size: tuple[int, int] = given(Table.size, (800, 600), (4096, 4096))
    views: int = given(Table.integer, 1, 1, 64)
    known_cameras: bool = given(Table.flag, False)
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        _, model = world.target(self.on)
        cameras = make_rig(model, self.views, *self.size, jitter=rng.random((self.views, 4)))
        pictures = []
        for k, camera in enumerate(cameras):
            picture: Float32 = np.clip(render(model, camera), 0.0, 1.0)
            for name, strength in self.attacks:
                picture = image_attack(name).apply(picture, strength, rng=rng)
            pictures.append(picture)
            advance((k + 1) / self.views)
        return Outcome(world, pictures=tuple(pictures), cameras=tuple(cameras) if self.known_cameras else None)
