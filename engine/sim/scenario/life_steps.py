"""Steps of a model's own life: it falls, is pressed, objects come and go.

A body's robust radius counts as one metre, so that everything falls and bends alike whatever its units are.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.formats import read_model
from engine.model import Float64, GaussianModel
from engine.numerics.similarity import transform_model
from engine.pipeline.rigs import UP, Extent, measure_extent
from engine.sim.physics.body import Body, Material, make_body, pose, strain_norms
from engine.sim.physics.world import STEP, Plane, step
from engine.sim.physics.world import World as Matter
from engine.sim.scenario.steps import StepKind
from engine.sim.scenario.tables import Table
from engine.sim.scenario.world import Advance, Outcome, World

__all__ = ["KINDS"]

GRAVITY = 9.81
FLOOR_QUANTILE = 0.005
"""The floor lies below all but this share of a body's centres: a floater does not hold it up."""


@dataclass(frozen=True)
class Simulate:
    """Bodies of soft matter on a floor, for some seconds; a lid may press them.

    Parameters
    ----------
    height : float
        Of the fall, radii.
    press : float
        Share of their height that is left when the lid stops; 1 presses nothing.
    seconds, frames : float, int
        Time that passes, and how many moments of it the film shows.
    compliance : float
        1 / Young's modulus, 1/Pa.
    resolution : int
        Voxels along the longest side of a body.
    """

    height: float
    press: float
    seconds: float
    frames: int
    compliance: float
    resolution: int
    on: str

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        """Let time pass; the bodies stay as they are at its end."""
        name, model = world.target(self.on)
        extent = measure_extent(model)
        metric = transform_model(model, 1.0 / extent.radius, np.eye(3), -extent.center / extent.radius)
        body = make_body(metric, resolution=self.resolution, material=Material(compliance=self.compliance))
        state = self._begin(body, metric)
        steps = max(1, round(self.seconds / STEP))
        shown = set(np.linspace(1, steps, min(self.frames, steps)).round().astype(int).tolist())
        frames = []
        for number in range(1, steps + 1):
            state = step(state)
            if number in shown:
                frames.append(_back(pose(state.bodies[0]), extent))
            advance(number / steps)
        end = _back(pose(state.bodies[0]), extent)
        strain = float(np.median(strain_norms(state.bodies[0])))
        note = f"median strain {strain:.3f}, {len(body.lattice.tets)} tetrahedra"
        shots = tuple(world.put(name, frame).flat() for frame in frames)
        return Outcome(world.put(name, end), frames=shots, notes=(note,))

    def _begin(self, body: Body, metric: GaussianModel) -> Matter:
        heights = metric.means.astype(np.float64) @ UP
        bottom, top = np.quantile(heights, [FLOOR_QUANTILE, 1.0 - FLOOR_QUANTILE])
        planes = [Plane((bottom - self.height) * UP, UP)]
        if self.press < 1.0:
            speed = (1.0 - self.press) * (top - bottom) / self.seconds
            planes.append(Plane((top + 0.02) * UP, -UP, -speed * UP))
        return Matter((body,), gravity=-GRAVITY * UP, planes=tuple(planes))


def _back(model: GaussianModel, extent: Extent) -> GaussianModel:
    return transform_model(model, extent.radius, np.eye(3), extent.center)


def read_drop(table: Table) -> Simulate:
    """`do = "drop", height, seconds, frames, compliance, resolution, on`."""
    return _simulate(table, table.number("height", 0.5, 0.0, 100.0), 1.0, 1.2)


def read_press(table: Table) -> Simulate:
    """`do = "press", share, seconds, frames, compliance, resolution, on`."""
    return _simulate(table, 0.0, table.number("share", 0.7, 0.1, 1.0), 1.5)


def _simulate(table: Table, height: float, press: float, seconds: float) -> Simulate:
    return Simulate(
        height,
        press,
        table.number("seconds", seconds, 0.02, 60.0),
        table.integer("frames", 24, 0, 1000),
        table.number("compliance", 2e-5, 0.0, 1.0),
        table.integer("resolution", 16, 2, 96),
        table.text("on", ""),
    )


@dataclass(frozen=True)
class AddObject:
    """Another, unmarked model is put into the scene."""

    name: str
    model: Path
    at: Float64
    size: float

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        """Place it: `at` and `size` in radii of the whole scene."""
        if self.name in world.objects or self.name in world.records:
            raise InputError(f"there is an object {self.name!r} already")
        new = read_model(self.model).model
        host, own = measure_extent(world.flat()), measure_extent(new)
        factor = self.size * host.radius / own.radius
        shift = host.center + host.radius * self.at - factor * own.center
        placed = transform_model(new, factor, np.eye(3), shift)
        return Outcome(replace(world, objects={**world.objects, self.name: placed}))


def read_add(table: Table) -> AddObject:
    """`do = "add", model, name, at, size`."""
    model = table.file("model")
    return AddObject(
        table.text("name", model.name.split(".")[0]),
        model,
        np.array(table.vector("at", (0.0, 0.0, 0.0))),
        table.number("size", 1.0, 1e-6, 1e6),
    )


@dataclass(frozen=True)
class RemoveObject:
    """An object is taken out of the scene."""

    name: str

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        """Take it out; its record stays, to be looked for in vain."""
        world.target(self.name)
        left = {name: model for name, model in world.objects.items() if name != self.name}
        if not left:
            raise InputError(f"{self.name!r} is the only object; nothing would be left")
        return Outcome(replace(world, objects=left))


def read_remove(table: Table) -> RemoveObject:
    """`do = "remove", name`."""
    return RemoveObject(table.text("name"))


KINDS = {
    "drop": StepKind(read_drop, "it falls as soft matter: height, seconds, frames, compliance, resolution, on"),
    "press": StepKind(read_press, "a lid presses it to a share of its height: share, seconds, frames, compliance, on"),
    "add": StepKind(read_add, "an unmarked model joins: model, name, at, size"),
    "remove": StepKind(read_remove, "an object is taken out: name"),
}
