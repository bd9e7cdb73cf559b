"""Steps of a model's own life: it falls, is pressed, objects come and go.

A body's robust radius counts as one metre, so that everything falls and bends alike whatever its units are.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.formats import read_model
from engine.model import GaussianModel
from engine.numerics.similarity import transform_model
from engine.pipeline.rigs import UP, Extent, measure_extent
from engine.sim.physics import world as matter
from engine.sim.physics.body import Material, make_body, pose, strain_norms
from engine.sim.scenario.marking import read_name
from engine.sim.scenario.tables import Table, given
from engine.sim.scenario.world import Advance, Outcome, StepKind, World, step

__all__ = ["KINDS"]

KINDS: dict[str, StepKind] = {}

GRAVITY = 9.81
FLOOR_QUANTILE = 0.005
"""The floor lies below all but this share of a body's centres: a floater does not hold it up."""


@dataclass(frozen=True)
class _Simulate(ABC):
    """Bodies of soft matter on a floor, for some seconds; a lid may press them."""

    seconds: float = given(Table.number, 1.0, 0.02, 60.0)
    frames: int = given(Table.integer, 24, 0, 1000)
    compliance: float = given(Table.number, 2e-5, 0.0, 1.0)  # 1 / Young's modulus, 1/Pa
    resolution: int = given(Table.integer, 16, 2, 96)  # voxels along the longest side of a body
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name, model = world.target(self.on)
        extent = measure_extent(model)
        metric = transform_model(model, 1.0 / extent.radius, np.eye(3), -extent.center / extent.radius)
        body = make_body(metric, resolution=self.resolution, material=Material(compliance=self.compliance))
        heights = metric.means.astype(np.float64) @ UP
        bottom, top = np.quantile(heights, [FLOOR_QUANTILE, 1.0 - FLOOR_QUANTILE])
        state = matter.World((body,), gravity=-GRAVITY * UP, planes=self.planes(float(bottom), float(top)))
        steps = max(1, round(self.seconds / matter.STEP))
        shown = set(np.linspace(1, steps, min(self.frames, steps)).round().astype(int).tolist())
        frames = []
        for number in range(1, steps + 1):
            state = matter.step(state)
            if number in shown:
                frames.append(_back(pose(state.bodies[0]), extent))
            advance(number / steps)
        end = _back(pose(state.bodies[0]), extent)
        strain = float(np.median(strain_norms(state.bodies[0])))
        note = f"median strain {strain:.3f}, {len(body.lattice.tets)} tetrahedra"
        shots = tuple(world.put(name, frame).flat() for frame in frames)
        return Outcome(world.put(name, end), frames=shots, notes=(note,))

    @abstractmethod
    def planes(self, bottom: float, top: float) -> tuple[matter.Plane, ...]:
        """The floor, and what else stops a body that stands between these heights."""


def _back(model: GaussianModel, extent: Extent) -> GaussianModel:
    return transform_model(model, extent.radius, np.eye(3), extent.center)


@step(KINDS, "drop", "it falls as soft matter: height, seconds, frames, compliance, resolution, on")
@dataclass(frozen=True)
class Drop(_Simulate):
    """A fall of `height` radii."""

    height: float = given(Table.number, 0.5, 0.0, 100.0)
    seconds: float = given(Table.number, 1.2, 0.02, 60.0)

    def planes(self, bottom: float, top: float) -> tuple[matter.Plane, ...]:
        return (matter.Plane((bottom - self.height) * UP, UP),)


@step(KINDS, "press", "a lid presses it to a share of its height: share, seconds, frames, compliance, on")
@dataclass(frozen=True)
class Press(_Simulate):
    """A lid that leaves `share` of the height; 1 presses nothing."""

    share: float = given(Table.number, 0.7, 0.1, 1.0)
    seconds: float = given(Table.number, 1.5, 0.02, 60.0)

    def planes(self, bottom: float, top: float) -> tuple[matter.Plane, ...]:
        floor = matter.Plane(bottom * UP, UP)
        if self.share == 1.0:
            return (floor,)
        speed = (1.0 - self.share) * (top - bottom) / self.seconds
        return floor, matter.Plane((top + 0.02) * UP, -UP, -speed * UP)


@step(KINDS, "add", "an unmarked model joins: model, name, at, size")
@dataclass(frozen=True)
class AddObject:
    """`at` and `size` in radii of the whole scene."""

    model: Path = given(Table.file)
    name: str = given(read_name)
    at: tuple[float, ...] = given(Table.vector, (0.0, 0.0, 0.0))
    size: float = given(Table.number, 1.0, 1e-6, 1e6)

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        if self.name in world.objects or self.name in world.records:
            raise InputError(f"there is an object {self.name!r} already")
        new = read_model(self.model).model
        host, own = measure_extent(world.flat()), measure_extent(new)
        factor = self.size * host.radius / own.radius
        shift = host.center + host.radius * np.array(self.at) - factor * own.center
        placed = transform_model(new, factor, np.eye(3), shift)
        return Outcome(replace(world, objects={**world.objects, self.name: placed}))


@step(KINDS, "remove", "an object is taken out: name")
@dataclass(frozen=True)
class RemoveObject:
    """Its record stays, to be looked for in vain."""

    name: str = given(Table.text)

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        world.target(self.name)
        left = {name: model for name, model in world.objects.items() if name != self.name}
        if not left:
            raise InputError(f"{self.name!r} is the only object; nothing would be left")
        return Outcome(replace(world, objects=left))
