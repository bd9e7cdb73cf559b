"""Steps of people who work on a model: move, turn, scale, recolour, delete, duplicate a selection of it.

Lengths and places are in robust radii of the model the step works on, about its centre: a scenario fits any scene.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.model import Bool, Float32, Float64, GaussianModel
from engine.numerics.umeyama import Similarity
from engine.pipeline.rigs import Extent, measure_extent
from engine.sim import edits
from engine.sim.edits.inpainting import inpaint
from engine.sim.scenario.steps import StepKind
from engine.sim.scenario.tables import Table
from engine.sim.scenario.viewpoint import viewpoint
from engine.sim.scenario.world import Advance, Outcome, World

__all__ = ["KINDS"]

MASK_SIZE = 512
SEGMENTS = 24
"""Segments among which `segment` chooses, where the scenario gives no number."""

Selector = Callable[[GaussianModel, Extent], Bool]
Change = Callable[[GaussianModel, Bool, Extent], GaussianModel]


@dataclass(frozen=True)
class EditSelection:
    """An edit of the selected Gaussians of an object."""

    select: Selector
    change: Change
    on: str

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        """Select and edit."""
        name, model = world.target(self.on)
        extent = measure_extent(model)
        chosen = self.select(model, extent)
        share = f"{100.0 * chosen.mean():.1f} % of {name} selected"
        return Outcome(world.put(name, self.change(model, chosen, extent)), notes=(share,))


def read_selector(table: Table) -> Selector:
    """`select = { box | sphere | segment | mask | disc | all }`; everything where there is no `select`."""
    inside = table.table("select")
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


def read_move(table: Table) -> EditSelection:
    """`do = "move", shift`."""
    shift = np.array(table.vector("shift", None))
    return _edit(table, lambda model, chosen, extent: edits.move(model, chosen, extent.radius * shift).model)


def read_rotate(table: Table) -> EditSelection:
    """`do = "rotate", axis, degrees`."""
    axis, degrees = table.vector("axis", (0.0, 1.0, 0.0)), table.number("degrees", None)
    return _edit(table, lambda model, chosen, extent: edits.rotate(model, chosen, axis, degrees).model)


def read_scale(table: Table) -> EditSelection:
    """`do = "scale", factor`."""
    factor = table.number("factor", None, 1e-6, 1e6)
    return _edit(table, lambda model, chosen, extent: edits.scale(model, chosen, factor).model)


def read_recolor(table: Table) -> EditSelection:
    """`do = "recolor", gain, tint`, or `color, amount`."""
    if "color" in table:
        color, amount = table.vector("color", None), table.number("amount", 0.5, 0.0, 1.0)
        return _edit(table, lambda m, chosen, extent: edits.recolor_towards(m, chosen, color, amount).model)
    gain, tint = table.vector("gain", (1.0, 1.0, 1.0)), table.vector("tint", (0.0, 0.0, 0.0))
    return _edit(table, lambda m, chosen, extent: edits.recolor(m, chosen, gain=gain, tint=tint).model)


def read_duplicate(table: Table) -> EditSelection:
    """`do = "duplicate", shift`."""
    shift = np.array(table.vector("shift", None))

    def copy(model: GaussianModel, chosen: Bool, extent: Extent) -> GaussianModel:
        return edits.duplicate(model, chosen, Similarity(1.0, np.eye(3), extent.radius * shift)).model

    return _edit(table, copy)


def read_delete(table: Table) -> EditSelection:
    """`do = "delete", inpaint`."""
    fill = table.flag("inpaint", True)

    def remove(model: GaussianModel, chosen: Bool, extent: Extent) -> GaussianModel:
        return (inpaint if fill else edits.delete)(model, chosen).model

    return _edit(table, remove)


def _edit(table: Table, change: Change) -> EditSelection:
    return EditSelection(read_selector(table), change, table.text("on", ""))


KINDS = {
    "move": StepKind(read_move, "shift = [x, y, z]; select, on"),
    "rotate": StepKind(read_rotate, "axis, degrees; select, on"),
    "scale": StepKind(read_scale, "factor; select, on"),
    "recolor": StepKind(read_recolor, "gain and tint, or color and amount; select, on"),
    "duplicate": StepKind(read_duplicate, "shift; select, on"),
    "delete": StepKind(read_delete, "inpaint = true fills the hole; select, on"),
}
