"""Steps in which objects come and go, and time passes for those that move."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import UP, measure_extent
from engine.formats import read_model
from engine.lab.sim.edits.objects import Scene, model_box
from engine.lab.sim.scenario.bringing import read_name, read_optional
from engine.lab.sim.scenario.tables import Table, given
from engine.lab.sim.scenario.world import Advance, Outcome, StepKind, World, step
from engine.model import Float64, GaussianModel
from engine.numerics.similarity import transform_model
from engine.numerics.umeyama import Similarity
from engine.scenes.clip_marking import move_record, visible

__all__ = ["KINDS"]

KINDS: dict[str, StepKind] = {}

TRIES = 400
"""Places that are tried for an inserted object."""
GAP = 1e-6
"""Objects that stand on each other do not count as being in each other's way; part of their height."""


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


def read_copied(table: Table, name: str) -> str:
    """The object that is copied, where no model file is named."""
    return table.text(name, "") if "model" in table else table.text(name)


@step(KINDS, "insert", "copies stand where boxes leave room: model or of, name, count, size, spread, stack")
@dataclass(frozen=True)
class Insert:
    """Copies of a file or of an object, found room for in the hierarchy of all objects' boxes.

    `size` is that of a copy, `spread` how far from the middle it may stand, in radii of the scene. With `stack` it
    stands on what a ray from above meets first, else on the ground.
    """

    model: Path | None = given(read_optional)
    of: str = given(read_copied)
    name: str = given(Table.text, "copy")
    count: int = given(Table.integer, 1, 1, 200)
    size: float = given(Table.number, 0.3, 1e-6, 1e6)
    spread: float = given(Table.number, 1.5, 0.0, 1e6)
    stack: bool = given(Table.flag, False)

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        new = world.target(self.of)[1] if self.model is None else read_model(self.model).model
        scene = Scene().insert_all((name, model, Similarity.identity()) for name, model in world.objects.items())
        host, own = measure_extent(world.flat()), measure_extent(new)
        factor = self.size * host.radius / own.radius
        ground = min(float(min(o.low @ UP, o.high @ UP)) for o in scene.objects.values())
        tried = 0
        for number in range(1, self.count + 1):
            for _ in range(TRIES):
                tried += 1
                turn = _yaw(rng.uniform(0.0, 2.0 * np.pi))
                upright = transform_model(new, factor, turn, np.zeros(3))
                low, high = model_box(upright)
                away, angle = self.spread * host.radius * np.sqrt(rng.random()), rng.uniform(0.0, 2.0 * np.pi)
                foot = host.center + away * np.array([np.cos(angle), 0.0, np.sin(angle)])
                shift = self._standing(scene, foot, low, high, ground)
                free = GAP * (high - low)
                if not scene.in_box(low + shift + free, high + shift - free):
                    break
            else:
                taken = f"{number - 1} of {self.count} copies stand"
                raise InputError(f"no room within {self.spread:g} radii for another of size {self.size:g}: {taken}")
            scene = scene.insert(_numbered(self.name, number, self.count), new, Similarity(factor, turn, shift))
            advance(number / self.count)
        objects = {name: scene.get(name).placed for name in scene.names}
        kept = {name: world.objects.get(name, model) for name, model in objects.items()}  # what stood stays as it is
        return Outcome(replace(world, objects=kept), notes=(f"{self.count} placed after {tried} looks",))

    def _standing(self, scene: Scene, foot: Float64, low: Float64, high: Float64, ground: float) -> Float64:
        """The shift by which a box stands with its middle over `foot`."""
        height = ground
        if self.stack:
            above = foot + (max(float(max(o.low @ UP, o.high @ UP)) for o in scene.objects.values()) - foot @ UP) * UP
            above = above + float(np.ptp([low @ UP, high @ UP])) * UP
            below = scene.along_ray(above, -UP)
            height = float(above @ UP) - below[0][1] if below else ground
        shift = foot - 0.5 * (low + high)
        shift -= (shift @ UP) * UP
        return np.asarray(shift + (height - min(float(low @ UP), float(high @ UP))) * UP)


def _yaw(angle: float) -> Float64:
    """The turn about UP."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _numbered(name: str, number: int, count: int) -> str:
    return f"{name} {number}" if count > 1 else name


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


@step(KINDS, "moment", "time passes for an object that moves: time, frames, on")
@dataclass(frozen=True)
class Moment:
    """A clip's moment, exported as plain Gaussians; its record is moved along by the owner's original."""

    time: float = given(Table.number, None)
    frames: int = given(Table.integer, 16, 0, 1000)
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name, model = world.target(self.on)
        clip = world.clips.get(name)
        if clip is None or clip.shown is not model:
            raise InputError(f"{name!r} is no clip as delivered; moving are {', '.join(world.clips) or 'none'}")
        low, high = clip.original.span
        if not low <= self.time <= high:
            raise InputError(f"time {self.time:g} lies outside the clip, {low:g} to {high:g}")

        def at(time: float) -> GaussianModel:
            return clip.place(visible(clip.marked.at(time)))

        frames = []
        for k in range(self.frames):
            frames.append(world.put(name, at(clip.time + (self.time - clip.time) * (k + 1) / self.frames)).flat())
            advance((k + 1) / self.frames)
        still = at(self.time)
        now = replace(clip, time=self.time, shown=still)
        record = move_record(clip.opened, clip.original, self.time)
        world = replace(world.put(name, still), clips={**world.clips, name: now})
        return Outcome(replace(world, records={**world.records, name: record}), frames=tuple(frames))
