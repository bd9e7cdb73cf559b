"""Deleting fills the hole from its neighbours: the surface around it goes on, in copies of its own Gaussians.

1. The ring of Gaussians around the hole, and the surface through it (`hole_surface`).
2. The surface seen along its normal: which cells are covered, in what colour; which are the hole.
3. Each cell of the hole is told which covered cell to copy (`exemplar`), textures continuing from the rim.
4. The Gaussians of that cell are copied: moved along the surface, turned with its normal, their height above
   it kept, their colour shifted to what the rim of the hole says.

A hole that no surface surrounds (something that stood alone in the air) is left empty.
"""

from dataclasses import dataclass, replace

import numpy as np

from engine.errors import InputError
from engine.lab.sim.attack import check_positive
from engine.lab.sim.edits.edit import Edited
from engine.lab.sim.edits.exemplar import complete_cells, enclosed, harmonic_fill, smooth
from engine.lab.sim.edits.hole_surface import HoleSurface, fit_surface, ring_around
from engine.lab.sim.edits.operations import delete
from engine.lab.sim.model_placement import join
from engine.model import Bool, Camera, Float64, GaussianModel, Int64, look_at
from engine.numerics.similarity import quaternion_product, rotation_to_quaternion
from engine.numerics.spherical_harmonics import sh_rotation
from engine.raster import prepare_view

__all__ = ["InpaintConfig", "inpaint"]

DISTANCE = 40.0  # the surface is looked at from so many of its half widths: nearly parallel rays

WIDEST_COPY = 0.75
"""Gaussians with a standard deviation above this share of the hole's radius are not copied: no texture of the
hole, they would smear over its rim."""

LEAST_RING = 300  # Gaussians that a ring is widened for

SHOWN, STOOD = 0.05, 0.1
"""Opacity from which a cell shows anything at all, and from which the deleted Gaussians stood in it."""

BASE_COLOR = 3.0
"""Standard deviation, in cells, of the average that is a surface's base colour; what is finer is texture."""

ROUNDS = 8  # times the surface is looked at again for cells that the copies so far left open


@dataclass(frozen=True)
class InpaintConfig:
    """Knobs of the inpainting."""

    ring: float = 0.6  # width of the ring that gives surface and texture, in radii of the hole
    cells: int = 96  # cells across the area looked at; the texture is copied in cells
    # opacity along the normal from which a cell counts as surface, in shares of the ring's own; (0, 1)
    covered: float = 0.85
    seed: int = 0  # of the surface's search

    def __post_init__(self) -> None:
        check_positive(self.ring, "ring width")
        if not 16 <= self.cells <= 512:
            raise InputError(f"cells must number 16 to 512, got {self.cells}")
        if not 0 < self.covered < 1:
            raise InputError(f"covered must lie in (0, 1), got {self.covered}")


def inpaint(model: GaussianModel, selection: Bool, config: InpaintConfig = InpaintConfig()) -> Edited:
    """Delete the selected Gaussians and fill the hole they leave in the surface around them.

    The Gaussians left come in their order, then the filling (`edit.filling`; None where no surface surrounds the
    hole). Copies carry the marked colours of the Gaussians they come from.
    """
    cut = delete(model, selection)
    rows = np.flatnonzero(selection)
    hole = model.take(rows)
    center = np.median(hole.means.astype(np.float64), axis=0)
    size = float(np.quantile(np.linalg.norm(hole.means - center, axis=1), 0.9))
    size = max(size, float(np.median(hole.scales.max(axis=1))))
    ring = model.take(ring_around(model, selection, config.ring * size, LEAST_RING))
    surface = fit_surface(ring, hole, size, np.random.default_rng(config.seed))  # 1
    filling = None if surface is None else _fill(cut.model, hole, surface, config)
    if filling is None:
        return cut
    edit = replace(cut.edit, name="inpaint", filling=filling)
    return Edited(edit.apply(model), edit)


def _fill(
    left: GaussianModel, hole: GaussianModel, surface: HoleSurface, config: InpaintConfig
) -> GaussianModel | None:
    from scipy.ndimage import binary_dilation

    frame = _Frame(left, hole, surface, config)
    color, alpha = frame.see(frame.support)  # 2; (H, W, 3), (H, W)
    usual = float(np.median(alpha[alpha > SHOWN])) if (alpha > SHOWN).any() else 0.0
    if usual == 0.0:
        return None
    known = alpha >= config.covered * usual
    _, footprint = frame.see(frame.place(hole))
    gap = enclosed(known, ~known & binary_dilation(footprint > STOOD))
    # What is copied is the texture; the base colour is the rim's, continued.
    base = smooth(color, known, BASE_COLOR)
    rim = harmonic_fill(base, known, gap)
    widest = WIDEST_COPY * frame.cell * float(np.sqrt(gap.sum() / np.pi))
    filling: GaussianModel | None = None
    wanted = gap
    for _ in range(ROUNDS):
        if not wanted.any():
            break
        source, done = complete_cells(color, known, wanted)  # 3
        shift = rim[done] - base[source[done][:, 0], source[done][:, 1]]
        more = frame.copy(np.argwhere(done), source[done], shift, widest)  # 4
        if more is None:
            break
        filling = more if filling is None else join(filling, more)
        _, alpha = frame.see(join(frame.support, frame.place(filling)))
        wanted = gap & (alpha < config.covered * usual)
    return filling


class _Frame:
    """The surface around a hole laid flat: cells of a grid over u and v, and the Gaussians that make it."""

    def __init__(self, left: GaussianModel, hole: GaussianModel, surface: HoleSurface, config: InpaintConfig) -> None:
        self.surface = surface
        gap = surface.local(hole.means)
        low, high = np.quantile(gap[:, :2], [0.01, 0.99], axis=0)
        self.middle = 0.5 * (low + high)
        reach = 0.5 * float((high - low).max()) + config.ring * surface.size
        local = surface.local(left.means)
        inside = (np.abs(local[:, :2] - self.middle) < reach).all(axis=1)
        rows = np.flatnonzero(inside & (np.abs(local[:, 2]) < surface.band))
        # Cells finer than the Gaussians hold no texture of their own, and patches of them too few Gaussians.
        usual = float(np.median(np.sort(left.scales[rows], axis=1)[:, 1])) if len(rows) else 0.0
        self.cells = int(np.clip(2.0 * reach / max(0.5 * usual, 2.0 * reach / config.cells), 16, config.cells))
        self.cell = 2.0 * reach / self.cells
        self.model, self.local = left.take(rows), local[rows]
        self.support = self.place(self.model)
        # In the flat world the surface is the plane z = 0 and the camera looks down on it.
        width = self.cell * self.cells
        eye = np.array([*self.middle, DISTANCE * width / 2])
        focal = DISTANCE / 2 * self.cells
        self.camera: Camera = look_at(eye, [*self.middle, 0.0], [0.0, 1.0, 0.0], focal, self.cells, self.cells)

    def place(self, model: GaussianModel) -> GaussianModel:
        """A model in the flat world: u, v and height as coordinates, base colour only."""
        turn = rotation_to_quaternion(self.surface.axes)
        quats = quaternion_product(turn, model.quats).astype(np.float32)
        means = self.surface.local(model.means).astype(np.float32)
        return model.with_(means=means, quats=quats, sh=model.sh[:, :1])

    def see(self, flat: GaussianModel) -> tuple[Float64, Float64]:
        """DC (cells, cells, 3) and opacity (cells, cells) of a flat model, along the normal."""
        if not len(flat):
            return np.zeros((self.cells, self.cells, 3)), np.zeros((self.cells, self.cells))
        image, alpha = prepare_view(flat, self.camera).render(flat.sh[:, 0])
        opacity = alpha.astype(np.float64)
        return image / np.maximum(opacity, 1e-3)[..., None], opacity

    def cell_of(self, local: Float64) -> Int64:
        """(n, 2) row and column of u, v: as the camera sees them, v upwards."""
        column = np.floor((local[:, 0] - self.middle[0]) / self.cell + self.cells / 2)
        row = np.floor((self.middle[1] - local[:, 1]) / self.cell + self.cells / 2)
        return np.stack([row, column], axis=1).astype(np.int64)

    def copy(self, target: Int64, source: Int64, shift: Float64, widest: float) -> GaussianModel | None:
        """Copies of the Gaussians in `source` cells, one set for each of the (m, 2) `target` cells."""
        home = self.cell_of(self.local)
        small = self.model.scales.max(axis=1) < widest
        inside = ((home >= 0) & (home < self.cells)).all(axis=1) & small
        rows = np.flatnonzero(inside)
        number = home[rows, 0] * self.cells + home[rows, 1]
        rows = rows[np.argsort(number, kind="stable")]
        number = np.sort(number, kind="stable")
        wanted = source[:, 0] * self.cells + source[:, 1]
        first, last = np.searchsorted(number, wanted), np.searchsorted(number, wanted, side="right")
        counts = last - first
        if not counts.sum():
            return None
        which = np.repeat(np.arange(len(target)), counts)  # (c,) target of each of the c copies
        within = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
        who = rows[first[which] + within]  # (c,)
        step = (target - source)[which] * self.cell  # (c, 2) down and right
        old = self.local[who]  # (c, 3)
        new = old + np.stack([step[:, 1], -step[:, 0], np.zeros(len(who))], axis=1)
        turns = _between(self.surface.normals(old[:, :2]), self.surface.normals(new[:, :2]))
        part = self.model.take(who)
        quats = quaternion_product(rotation_to_quaternion(turns), part.quats)
        sh = part.sh.astype(np.float64)  # (c, K, 3)
        sh[:, 1:] = sh_rotation(turns, part.sh_degree)[:, 1:, 1:] @ sh[:, 1:]
        sh[:, 0] += shift[which]
        return part.with_(means=self.surface.world(new), quats=quats, sh=sh)


def _between(a: Float64, b: Float64) -> Float64:
    """(n, 3, 3) the smallest rotations that take unit vectors a to unit vectors b, not opposite."""
    v, c = np.cross(a, b), np.einsum("ni,ni->n", a, b)
    zero = np.zeros(len(a))
    K = np.stack([zero, -v[:, 2], v[:, 1], v[:, 2], zero, -v[:, 0], -v[:, 1], v[:, 0], zero], axis=1)
    K = K.reshape(-1, 3, 3)  # (n, 3, 3) of the cross product
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + c)[:, None, None])
