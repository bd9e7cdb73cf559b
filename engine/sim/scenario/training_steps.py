"""Steps of thieves with patience: fine-tuning, re-training from renders, putting several copies together."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from engine.numerics.similarity import transform_model
from engine.pipeline.rigs import make_rig
from engine.registration.registering import register
from engine.sim.adversaries.collusion import RULES, collude
from engine.sim.adversaries.retraining import RetrainConfig, quality_lost, retrain
from engine.sim.capture.training import TrainConfig
from engine.sim.cost import model_cost
from engine.sim.fine_tuning import SETTINGS, FineTuneSetting, fine_tune, pictures_of
from engine.sim.scenario.marking import mark
from engine.sim.scenario.steps import StepKind
from engine.sim.scenario.tables import Table
from engine.sim.scenario.theft_steps import COST_SIZE, COST_VIEWS
from engine.sim.scenario.world import Advance, Outcome, World

__all__ = ["KINDS"]


@dataclass(frozen=True)
class FineTune:
    """Training the stolen model on (paper, Table 5)."""

    setting: FineTuneSetting
    epochs: int
    trained: Literal["all", "colors"]
    size: int
    on: str

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        """Train; the attacker's clean pictures show what was registered."""
        name, model = world.target(self.on)
        opened = world.record_of(name)
        seed = int(rng.integers(2**31))
        clean = world.unmarked[name]
        found = register(clean, model, seed=seed)
        if found.found:  # back to where the pictures show it
            model = transform_model(model, found.scale, found.R, found.t)
        cameras, images = pictures_of(self.setting, clean, model, opened.cameras, size=self.size, seed=seed)
        tuned = fine_tune(model, cameras, images, self.epochs, trained=self.trained, seed=seed, advance=advance)
        cost = model_cost(model, tuned, views=COST_VIEWS, size=COST_SIZE)
        if found.found:
            back = found.R.T / found.scale
            tuned = transform_model(tuned, 1.0 / found.scale, found.R.T, -back @ found.t)
        return Outcome(world.put(name, tuned), cost=cost)


def read_fine_tune(table: Table) -> FineTune:
    """`do = "fine_tune", setting, epochs, trained, size, on`."""
    setting = table.text("setting", "clean+key", tuple(SETTINGS))
    trained = table.text("trained", "all", ("all", "colors"))
    return FineTune(
        SETTINGS[setting],
        table.integer("epochs", 100, 1, 100_000),
        trained,  # type: ignore[arg-type]
        table.integer("size", 400, 32, 2048),
        table.text("on", ""),
    )


@dataclass(frozen=True)
class Retrain:
    """A fresh model trained from nothing but renders of the stolen one."""

    views: int
    steps: int
    points: int
    size: int
    on: str

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        """Render, train; not one Gaussian of the new model is one of the old."""
        name, model = world.target(self.on)
        cameras = make_rig(model, self.views, self.size, self.size, jitter=rng.random((self.views, 4)))
        train = TrainConfig(steps=self.steps, sh_degree=0, densify=None, opacity_rate=0.02)
        config = RetrainConfig(points=self.points, train=train, seed=int(rng.integers(2**31)))
        fresh = retrain(model, cameras, config, advance)
        held_out = make_rig(model, 4, self.size, self.size, jitter=rng.random((4, 4)))
        lost = quality_lost(fresh, model, held_out)
        note = ", ".join(f"{word.replace('_', ' ')} {value:.1f} dB" for word, value in lost.items())
        return Outcome(world.put(name, fresh), notes=(note,))


def read_retrain(table: Table) -> Retrain:
    """`do = "retrain", views, steps, points, size, on`."""
    return Retrain(
        table.integer("views", 100, 1, 10_000),
        table.integer("steps", 3000, 1, 1_000_000),
        table.integer("points", 50_000, 100, 10_000_000),
        table.integer("size", 400, 32, 2048),
        table.text("on", ""),
    )


@dataclass(frozen=True)
class Collude:
    """Several buyers put their copies together; every one of them should be named."""

    copies: int
    rule: str
    on: str

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        """Mark further copies of what was registered, and combine them; their records join the world's."""
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


def read_collude(table: Table) -> Collude:
    """`do = "collude", copies, rule, on`."""
    return Collude(table.integer("copies", 3, 2, 10), table.text("rule", "mean", tuple(RULES)), table.text("on", ""))


KINDS = {
    "fine_tune": StepKind(read_fine_tune, "training goes on: setting, epochs, trained = all | colors, size, on"),
    "retrain": StepKind(read_retrain, "a fresh model from renders: views, steps, points, size, on"),
    "collude": StepKind(read_collude, "several copies become one: copies, rule, on"),
}
