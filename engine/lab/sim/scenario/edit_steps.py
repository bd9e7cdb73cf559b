"""Steps that edit a model, add and remove objects, and let time pass for objects that move.

Lengths and places are in robust radii of the model the step works on, about its center: a scenario fits any scene.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import UP, Extent, measure_extent
from engine.formats import read_model
from engine.lab.sim.edits import edit as edits
from engine.lab.sim.edits import selection
from engine.lab.sim.edits.inpainting import inpaint
from engine.lab.sim.edits.objects import Scene, model_box
from engine.lab.sim.scenario.sources import read_name, read_optional
from engine.lab.sim.scenario.state import Advance, Outcome, StepKind, Tracked, World, step, viewpoint
from engine.lab.sim.scenario.tables import Table, given
from engine.model import Bool, Float32, Float64, GaussianModel
from engine.numerics.similarity import transform_model
from engine.numerics.umeyama import Similarity
from engine.scenes.clip_marking import move_record, visible

__all__ = ["KINDS"]


KINDS: dict[str, StepKind] = {}

TRIES = 400  # places that are tried for an inserted object
GAP = 1e-6  # objects that stand on each other do not count as being in each other's way; part of their height


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
    """Its record stays, and later verifications should not find it."""

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


MASK_SIZE = 512
SEGMENTS = 24  # segments among which `segment` chooses, where the scenario gives no number

Selector = Callable[[GaussianModel, Extent], Bool]
Change = Callable[[GaussianModel, Bool], edits.Edited]


def read_selector(table: Table, name: str) -> Selector:
    """`select = { box | sphere | segment | mask | disc }`; everything where there is no `select`."""
    inside = table.table(name)
    if inside is None:
        return lambda model, extent: np.ones(len(model), dtype=np.bool_)
    selector = _read_selector(inside)
    inside.done()
    return selector


def _read_selector(table: Table) -> Selector:
    given = [word for word in ("box", "sphere", "segment", "mask", "disc") if word in table]
    if len(given) != 1:
        raise InputError(
            f"{table.place}: give one of box, sphere, segment, mask, disc; got {', '.join(given) or 'none'}"
        )
    if given[0] == "box":
        corners = np.reshape(table.vector("box", None, 6), (2, 3))
        return lambda model, extent: selection.select_box(model, _at(corners[0], extent), _at(corners[1], extent))
    if given[0] == "sphere":
        *middle, radius = table.vector("sphere", None, 4)
        return lambda model, extent: selection.select_sphere(model, _at(middle, extent), radius * extent.radius)
    if given[0] == "segment":
        point, count = table.vector("segment", None), table.integer("segments", SEGMENTS, 1, 4096)

        def by_segment(model: GaussianModel, extent: Extent) -> Bool:
            return selection.segment_at(model, selection.segment(model, count), _at(point, extent))

        return by_segment
    mask = _mask_file(table.file("mask")) if given[0] == "mask" else _disc(*table.vector("disc", None))
    azimuth, elevation = table.vector("seen_from", (0.0, 20.0), 2)

    def by_mask(model: GaussianModel, extent: Extent) -> Bool:
        camera = viewpoint(extent, azimuth, elevation, mask.shape[1], mask.shape[0])
        return selection.lift_masks(model, [camera], [mask])

    return by_mask


def _at(place: Float64 | tuple[float, ...] | list[float], extent: Extent) -> Float64:
    return np.asarray(extent.center + extent.radius * np.asarray(place, dtype=np.float64))


def _mask_file(path: Path) -> Float32:
    """A picture as a mask: white is inside."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as picture:
            return np.asarray(picture.convert("L"), dtype=np.float32) / 255.0
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise InputError(f"{str(path)!r} is no picture that could be a mask: {error}") from error


def _disc(u: float, v: float, radius: float) -> Float32:
    """A disc in a square picture; center and radius in shares of its side."""
    y, x = (np.mgrid[:MASK_SIZE, :MASK_SIZE] + 0.5) / MASK_SIZE
    return np.asarray((x - u) ** 2 + (y - v) ** 2 <= radius**2, dtype=np.float32)


def read_paint(table: Table, name: str) -> Change:
    """`gain, tint`, or `color, amount`."""
    if "color" in table:
        color, amount = table.vector("color", None), table.number("amount", 0.5, 0.0, 1.0)
        return lambda model, chosen: edits.recolor_towards(model, chosen, color, amount)
    gain, tint = table.vector("gain", (1.0, 1.0, 1.0)), table.vector("tint", (0.0, 0.0, 0.0))
    return lambda model, chosen: edits.recolor(model, chosen, gain=gain, tint=tint)


@dataclass(frozen=True)
class _Edit(ABC):
    """An edit of the selected Gaussians of an object."""

    select: Selector = given(read_selector)
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name, model = world.target(self.on)
        extent = measure_extent(model)
        chosen = self.select(model, extent)
        share = f"{100.0 * chosen.mean():.1f} % of {name} selected"
        edited = self.change(model, chosen, extent)
        world = world.put(name, edited.model)
        known = world.tracks.get(name)
        if known is not None and known.end is model:  # nothing else has happened to it: the owner's own edit
            tracked = Tracked(known.track.then(edited.edit), edited.model)
            world = replace(world, tracks={**world.tracks, name: tracked})
        return Outcome(world, notes=(share,))

    @abstractmethod
    def change(self, model: GaussianModel, chosen: Bool, extent: Extent) -> edits.Edited: ...


@step(KINDS, "move", "a selection is moved: shift = [x, y, z]; select, on")
@dataclass(frozen=True)
class Move(_Edit):
    shift: tuple[float, ...] = given(Table.vector, None)

    def change(self, model: GaussianModel, chosen: Bool, extent: Extent) -> edits.Edited:
        return edits.move(model, chosen, extent.radius * np.array(self.shift))


@step(KINDS, "rotate", "a selection is turned: axis, degrees; select, on")
@dataclass(frozen=True)
class Rotate(_Edit):
    axis: tuple[float, ...] = given(Table.vector, (0.0, 1.0, 0.0))
    degrees: float = given(Table.number, None)

    def change(self, model: GaussianModel, chosen: Bool, extent: Extent) -> edits.Edited:
        return edits.rotate(model, chosen, self.axis, self.degrees)


@step(KINDS, "scale", "a selection is scaled: factor; select, on")
@dataclass(frozen=True)
class Scale(_Edit):
    factor: float = given(Table.number, None, 1e-6, 1e6)

    def change(self, model: GaussianModel, chosen: Bool, extent: Extent) -> edits.Edited:
        return edits.scale(model, chosen, self.factor)


@step(KINDS, "recolor", "a selection is painted: gain and tint, or color and amount; select, on")
@dataclass(frozen=True)
class Recolor(_Edit):
    paint: Change = given(read_paint)

    def change(self, model: GaussianModel, chosen: Bool, extent: Extent) -> edits.Edited:
        return self.paint(model, chosen)


@step(KINDS, "duplicate", "a selection is copied: shift; select, on")
@dataclass(frozen=True)
class Duplicate(_Edit):
    shift: tuple[float, ...] = given(Table.vector, None)

    def change(self, model: GaussianModel, chosen: Bool, extent: Extent) -> edits.Edited:
        return edits.duplicate(model, chosen, Similarity(1.0, np.eye(3), extent.radius * np.array(self.shift)))


@step(KINDS, "delete", "a selection is removed and the hole filled: inpaint = true; select, on")
@dataclass(frozen=True)
class Delete(_Edit):
    inpaint: bool = given(Table.flag, True)

    def change(self, model: GaussianModel, chosen: Bool, extent: Extent) -> edits.Edited:
        return (inpaint if self.inpaint else edits.delete)(model, chosen)
