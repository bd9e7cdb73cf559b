"""Steps of people who work on a model: move, turn, scale, recolour, delete, duplicate a selection of it.

Lengths and places are in robust radii of the model the step works on, about its centre: a scenario fits any scene.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import Extent, measure_extent
from engine.lab.sim import edits
from engine.lab.sim.edits.inpainting import inpaint
from engine.lab.sim.scenario.tables import Table, given
from engine.lab.sim.scenario.world import Advance, Outcome, StepKind, Tracked, World, step, viewpoint
from engine.model import Bool, Float32, Float64, GaussianModel
from engine.numerics.umeyama import Similarity

__all__ = ["KINDS"]

KINDS: dict[str, StepKind] = {}

MASK_SIZE = 512
SEGMENTS = 24
"""Segments among which `segment` chooses, where the scenario gives no number."""

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
        return lambda model, extent: edits.select_box(model, _at(corners[0], extent), _at(corners[1], extent))
    if given[0] == "sphere":
        *middle, radius = table.vector("sphere", None, 4)
        return lambda model, extent: edits.select_sphere(model, _at(middle, extent), radius * extent.radius)
    if given[0] == "segment":
        point, count = table.vector("segment", None), table.integer("segments", SEGMENTS, 1, 4096)

        def by_segment(model: GaussianModel, extent: Extent) -> Bool:
            return edits.segment_at(model, edits.segment(model, count), _at(point, extent))

        return by_segment
    mask = _mask_file(table.file("mask")) if given[0] == "mask" else _disc(*table.vector("disc", None))
    azimuth, elevation = table.vector("seen_from", (0.0, 20.0), 2)

    def by_mask(model: GaussianModel, extent: Extent) -> Bool:
        camera = viewpoint(extent, azimuth, elevation, mask.shape[1], mask.shape[0])
        return edits.lift_masks(model, [camera], [mask])

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
    """A disc in a square picture; centre and radius in shares of its side."""
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
