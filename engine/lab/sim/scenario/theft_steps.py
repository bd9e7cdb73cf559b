"""Steps of an attacker: attacks on models, pictures that turn up, fine-tuning, re-training from renders, collusion."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from engine.flows.views.camera_rig import make_rig
from engine.lab.sim.adversaries.collusion import RULES, collude
from engine.lab.sim.adversaries.retraining import SETTINGS, RetrainConfig, fine_tune, pictures_of, quality_lost, retrain
from engine.lab.sim.attack import Strength
from engine.lab.sim.attack_cost import model_cost
from engine.lab.sim.attacks import image_attack, model_attack
from engine.lab.sim.capture.trainer import TrainConfig
from engine.lab.sim.scenario.sources import mark
from engine.lab.sim.scenario.state import Advance, Outcome, StepKind, World, step
from engine.lab.sim.scenario.tables import Table, given
from engine.model import Float32
from engine.numerics.similarity import mirror_model, transform_model
from engine.raster import render
from engine.registration.registration_search import register

KINDS: dict[str, StepKind] = {}
PATIENT: dict[str, StepKind] = {}  # steps of attackers who train models of their own or have several copies
COST_VIEWS, COST_SIZE = 2, 300  # neutral views in which an attack's cost is measured, and their side in pixels


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
    """Random views, through a chain of image attacks; the world stays as it was."""

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


def read_trained(table: Table, name: str) -> Literal["all", "colors"]:
    """What moves."""
    return "all" if table.text(name, "all", ("all", "colors")) == "all" else "colors"


@step(PATIENT, "fine_tune", "training goes on: setting, epochs, trained = all | colors, size, on")
@dataclass(frozen=True)
class FineTune:
    """Training the stolen model on (paper, Table 5); the attacker's clean pictures show what was registered."""

    setting: str = given(Table.text, "clean+key", tuple(SETTINGS))
    trained: Literal["all", "colors"] = given(read_trained)
    epochs: int = given(Table.integer, 100, 1, 100_000)
    size: int = given(Table.integer, 400, 32, 2048)
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name, model = world.target(self.on)
        opened = world.record_of(name)
        seed = int(rng.integers(2**31))
        clean = world.unmarked[name]
        found = register(clean, model, seed=seed)
        if found.found:  # back to where the pictures show it
            model = found.place(model)
        cameras, images = pictures_of(SETTINGS[self.setting], clean, model, opened.cameras, size=self.size, seed=seed)
        tuned = fine_tune(model, cameras, images, self.epochs, trained=self.trained, seed=seed, advance=advance)
        cost = model_cost(model, tuned, views=COST_VIEWS, size=COST_SIZE)
        if found.found:
            back = found.R.T / found.scale
            tuned = transform_model(tuned, 1.0 / found.scale, found.R.T, -back @ found.t)
            tuned = mirror_model(tuned) if found.mirrored else tuned
        return Outcome(world.put(name, tuned), cost=cost)


@step(PATIENT, "retrain", "a fresh model from renders: views, steps, points, size, on")
@dataclass(frozen=True)
class Retrain:
    """A model trained from nothing but renders: not one of its Gaussians is one of the stolen model's."""

    views: int = given(Table.integer, 100, 1, 10_000)
    steps: int = given(Table.integer, 3000, 1, 1_000_000)
    points: int = given(Table.integer, 50_000, 100, 10_000_000)
    size: int = given(Table.integer, 400, 32, 2048)
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name, model = world.target(self.on)
        cameras = make_rig(model, self.views, self.size, self.size, jitter=rng.random((self.views, 4)))
        train = TrainConfig(steps=self.steps, sh_degree=0, densify=None, opacity_rate=0.02)
        config = RetrainConfig(points=self.points, train=train, seed=int(rng.integers(2**31)))
        fresh = retrain(model, cameras, config, advance)
        held_out = make_rig(model, 4, self.size, self.size, jitter=rng.random((4, 4)))
        lost = quality_lost(fresh, model, held_out)
        note = ", ".join(f"{word.replace('_', ' ')} {value:.1f} dB" for word, value in lost.items())
        return Outcome(world.put(name, fresh), notes=(note,))


@step(PATIENT, "collude", "several copies become one: copies, rule, on")
@dataclass(frozen=True)
class Collude:
    """Several buyers put their copies together, which are marked here; every one of them should be named."""

    copies: int = given(Table.integer, 3, 2, 10)
    rule: str = given(Table.text, "mean", tuple(RULES))
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name, _ = world.target(self.on)
        first = world.record_of(name)
        records, models = {}, []
        for number in range(1, self.copies + 1):
            made, opened = mark(
                world.unmarked[name],
                world.key,
                first.header.original_digest,
                len(first.message),
                world.profiles[name],
                copy=f"{name} copy {number}",
            )
            records[f"{name} copy {number}"] = opened
            models.append(made)
            advance(number / self.copies)
        mixed = collude(models[0], self.rule, rng, others=models[1:])
        cost = model_cost(models[0], mixed, views=COST_VIEWS, size=COST_SIZE)
        left = {other: record for other, record in world.records.items() if other != name}
        world = replace(world, records={**left, **records})
        return Outcome(world.put(name, mixed), cost=cost)
