"""Steps of thieves: attacks on models, pictures that turn up, fine-tuning."""

from dataclasses import dataclass

import numpy as np

from engine.errors import InputError
from engine.model import Camera, Float32
from engine.pipeline.rigs import make_rig
from engine.raster import render
from engine.sim.attack import Strength
from engine.sim.attacks import image_attack, model_attack
from engine.sim.cost import model_cost
from engine.sim.scenario.steps import StepKind
from engine.sim.scenario.tables import Table
from engine.sim.scenario.world import Advance, Outcome, World

__all__ = ["KINDS"]

COST_VIEWS, COST_SIZE = 2, 300
"""Neutral views in which an attack's cost is measured, and their side in pixels."""


@dataclass(frozen=True)
class AttackModel:
    """An attack of the registry on the file, or on one object."""

    name: str
    strength: Strength | None
    reading: str | None
    on: str

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        """Apply it."""
        name, model = world.target(self.on)
        attacked = model_attack(self.name).apply(model, self.strength, rng=rng, reading=self.reading)
        cost = model_cost(model, attacked, views=COST_VIEWS, size=COST_SIZE)
        return Outcome(world.put(name, attacked), cost=cost)


def read_attack(table: Table) -> AttackModel:
    """`do = "attack", name, strength, reading, on`."""
    name = table.text("name")
    attack = model_attack(name)
    reading = table.text("reading", "-", ("-", *(r.label for r in attack.readings)))
    return AttackModel(name, table.strength("strength"), None if reading == "-" else reading, table.text("on", ""))


@dataclass(frozen=True)
class TakePictures:
    """Only pictures turn up: views that nobody planned, through a chain of image attacks."""

    views: int
    size: tuple[int, int]
    attacks: tuple[tuple[str, Strength | None], ...]
    known_cameras: bool
    on: str

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        """Render and attack; the world stays as it was."""
        _, model = world.target(self.on)
        cameras = make_rig(model, self.views, *self.size, jitter=rng.random((self.views, 4)))
        pictures = []
        for k, camera in enumerate(cameras):
            picture: Float32 = np.clip(render(model, camera), 0.0, 1.0)
            for name, strength in self.attacks:
                picture = image_attack(name).apply(picture, strength, rng=rng)
            pictures.append(picture)
            advance((k + 1) / self.views)
        told: tuple[Camera, ...] | None = tuple(cameras) if self.known_cameras else None
        return Outcome(world, pictures=tuple(pictures), cameras=told)


def read_pictures(table: Table) -> TakePictures:
    """`do = "pictures", views, size, attacks, known_cameras, on`."""
    attacks = table.pairs("attacks")
    for name, _ in attacks:
        image_attack(name)  # an unknown one is refused before any work
    width, height = (int(side) for side in table.vector("size", (800, 600), 2))
    if not (64 <= width <= 4096 and 64 <= height <= 4096):
        raise InputError(f"{table.place}: size must lie in 64..4096 pixels a side, got {width}x{height}")
    return TakePictures(
        table.integer("views", 1, 1, 64),
        (width, height),
        attacks,
        table.flag("known_cameras", False),
        table.text("on", ""),
    )


KINDS = {
    "attack": StepKind(read_attack, "an attack on the model: name, strength, reading, on"),
    "pictures": StepKind(
        read_pictures, "only pictures turn up: views, size, attacks = [[name, strength]], known_cameras, on"
    ),
}
