"""Deleting fills the hole from its neighbors: the surface around it goes on, in copies of its own Gaussians.

1. The ring of Gaussians around the hole, and the surface through it: a quadric height field.
2. The surface seen along its normal: which cells are covered, in what color; which are the hole.
3. For each cell of the hole, the covered cell to copy, textures continuing from the rim (Criminisi, Perez, Toyama,
   "Region filling and object removal by exemplar-based inpainting", IEEE TIP 2004): the hole closes from its rim, and
   each patch on the rim is completed from the known patch that fits it best.
4. The Gaussians of that cell are copied: moved along the surface, turned with its normal, their height above
   it kept, their color shifted to that of the hole's rim.

A hole that no surface surrounds (something that stood alone in the air) is left empty.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from engine.lab.sim.edits.edit import Edited, delete
from engine.lab.sim.model_placement import join
from engine.model import Bool, Camera, Float64, GaussianModel, Int64, look_at
from engine.numerics.similarity import quaternion_product, rotation_to_quaternion
from engine.numerics.spherical_harmonics import sh_rotation
from engine.raster import prepare_view

PLANES = 400
"""Planes tried through three ring Gaussians each: with a fifth of them on the surface, all 400 miss it with
probability 4 %, with a third of them never."""

TUKEY = 4.685 * 1.4826
"""Tukey's constant times the standard deviation of a normal law over its median absolute deviation."""

PLANE_BAND, WIDEST_BAND, FINEST_BAND = 0.15, 0.5, 0.02
"""Distances that count as on the plane, and as on the quadric at first and at last, in radii of the hole."""

BENDING = 0.02  # cost of the quadric's second derivatives: a ring says little about them far inside the hole
FEWEST_FITTED = 24  # ring Gaussians below which no surface is fitted: a quadric has 6 coefficients


@dataclass(frozen=True, eq=False)
class HoleSurface:
    """x(u, v) = origin + u e1 + v e2 + height(u, v) normal, lengths in scene units."""

    origin: Float64  # (3,)
    axes: Float64  # (3, 3) rows e1, e2 and the normal; right-handed
    coefficients: Float64  # (6,) of 1, u, v, u^2, u v, v^2 in the height, u and v divided by `size`
    size: float  # length that the coefficients count in
    band: float  # heights above or below the surface within which a Gaussian belongs to it

    def local(self, points: npt.NDArray[np.generic]) -> Float64:
        """(n, 3) u, v and height above the surface of points (n, 3)."""
        flat = (points.astype(np.float64) - self.origin) @ self.axes.T
        flat[:, 2] -= self._height(flat[:, :2])
        return np.asarray(flat)

    def world(self, local: Float64) -> Float64:
        """(n, 3) points of u, v and height (n, 3)."""
        flat = local.copy()
        flat[:, 2] += self._height(local[:, :2])
        return np.asarray(flat @ self.axes + self.origin)

    def normals(self, uv: Float64) -> Float64:
        """(n, 3) unit normals at (n, 2)."""
        u, v = uv[:, 0] / self.size, uv[:, 1] / self.size
        _, b, c, d, e, f = self.coefficients / self.size
        slope = np.stack([-(b + 2 * d * u + e * v), -(c + e * u + 2 * f * v), np.ones_like(u)], axis=1)
        slope /= np.linalg.norm(slope, axis=1, keepdims=True)
        return np.asarray(slope @ self.axes)

    def _height(self, uv: Float64) -> Float64:
        return np.asarray(_quadric(uv / self.size) @ self.coefficients)


def visible_area(model: GaussianModel) -> Float64:
    """(n,) opacity times the area of the two larger axes, capped at its 95 % quantile: who makes a surface."""
    log_area = np.sort(model.log_scales.astype(np.float64), axis=1)[:, 1:].sum(axis=1)
    area = np.exp(np.minimum(log_area, np.quantile(log_area, 0.95)) - log_area.max())
    return np.asarray(model.opacities.astype(np.float64) * area)


def ring_around(model: GaussianModel, selection: Bool, width: float, least: int) -> Int64:
    """Unselected Gaussians within `width` (scene units) of a selected one; wider until `least` are found."""
    from scipy.spatial import cKDTree

    rest = np.flatnonzero(~selection)
    distance, _ = cKDTree(model.means[selection]).query(model.means[rest], workers=1)
    reach = max(width, float(np.sort(distance)[min(least, len(rest)) - 1]))
    return np.asarray(rest[distance <= reach], dtype=np.int64)


def fit_surface(ring: GaussianModel, hole: GaussianModel, size: float, rng: np.random.Generator) -> HoleSurface | None:
    """The dominant surface through a ring, facing the side on which the hole's Gaussians were.

    The dominant plane by RANSAC, weighted by visible area; then a quadric by Tukey's biweight with a band that closes
    in. `size` is the hole's radius, scene units. None where the ring is too small or spans no plane.
    """
    if len(ring) < FEWEST_FITTED:
        return None
    points, weights = ring.means.astype(np.float64), visible_area(ring)
    if not weights.sum() > 0:
        return None
    found = _dominant_plane(points, weights, PLANE_BAND * size, rng)
    if found is None:
        return None
    origin, normal = found
    if (np.median(hole.means.astype(np.float64), axis=0) - origin) @ normal < 0:
        normal = -normal
    e1 = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    e1 /= np.linalg.norm(e1)
    axes = np.stack([e1, np.cross(normal, e1), normal])
    local = (points - origin) @ axes.T  # (n, 3) u, v, height above the plane
    design, height = _quadric(local[:, :2] / size), local[:, 2]  # (n, 6), (n,)
    coefficients = np.zeros(6)
    band = WIDEST_BAND * size
    stiff = np.diag([0.0, 0.0, 0.0, BENDING, BENDING, BENDING])
    for _ in range(12):
        error = height - design @ coefficients
        w = weights * np.square(np.clip(1.0 - np.square(error / band), 0.0, None))
        if np.count_nonzero(w) < FEWEST_FITTED // 2:
            break
        normal_matrix = (design * w[:, None]).T @ design / w.sum() + stiff + 1e-9 * np.eye(6)
        coefficients = np.linalg.solve(normal_matrix, (design * w[:, None]).T @ height / w.sum())
        near = np.abs(height - design @ coefficients) < band
        spread = _weighted_median(np.abs(height - design @ coefficients)[near], weights[near])
        band = min(band, max(TUKEY * spread, FINEST_BAND * size))
    return HoleSurface(origin, axes, coefficients, size, band)


def _dominant_plane(
    points: Float64, weights: Float64, tolerance: float, rng: np.random.Generator
) -> tuple[Float64, Float64] | None:
    """A point and the unit normal of the plane with most weight within the tolerance."""
    chance = weights / weights.sum()
    best, answer = 0.0, None
    for _ in range(PLANES):
        a, b, c = points[rng.choice(len(points), 3, replace=False, p=chance)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < 1e-3 * tolerance**2:
            continue
        normal /= length
        explained = float(weights[np.abs((points - a) @ normal) < tolerance].sum())
        if explained > best:
            best, answer = explained, (a, normal)
    if answer is None:
        return None
    inside = np.abs((points - answer[0]) @ answer[1]) < tolerance
    w = weights[inside] / weights[inside].sum()
    center = w @ points[inside]
    spread = points[inside] - center
    _, vectors = np.linalg.eigh((spread * w[:, None]).T @ spread)
    return center, np.asarray(vectors[:, 0])


def _weighted_median(values: Float64, weights: Float64) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(cumulative, 0.5 * cumulative[-1])]])


def _quadric(uv: Float64) -> Float64:
    u, v = uv[:, 0], uv[:, 1]
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)


SIDES = (7, 5, 3, 1)  # patch sides, cells; smaller ones serve where no larger known patch exists
MOST_SOURCES = 6000  # source patches compared with each patch of the rim; more are thinned out evenly
BREATH = 1e-6  # weight of the mean in Laplace's equation: keeps islands solvable without moving the others
FEWEST_SOURCES = 16  # known patches of a side below which a smaller side is taken
REUSE = 0.15  # cost of each earlier use of a source patch, in units of the median patch distance: spreads the sources


def complete_cells(colors: Float64, known: Bool, wanted: Bool) -> tuple[Int64, Bool]:
    """Row and column of the cell to copy into every wanted cell, (H, W, 2), and the cells completed, (H, W) bool.

    Colors (H, W, 3) are meaningful where known (H, W); no wanted cell is. All wanted cells are completed, unless
    nothing is known.
    """
    source = np.zeros((*wanted.shape, 2), np.int64)
    image, filled = np.where(known[..., None], colors, 0.0), known.copy()
    if not known.any():
        return source, np.zeros_like(wanted)
    side, middles, patches = _source_patches(image, known)
    half = side // 2
    used = np.zeros(len(middles))
    scale = max(float(np.median(np.var(patches, axis=0))), 1e-12)
    offsets = np.indices((side, side)).reshape(2, -1).T - half
    padded = ((half, half), (half, half))
    left = wanted & ~filled
    while left.any():
        # The rim cell with most known cells about it is the surest to complete.
        votes = _box_sum(filled, half)
        rim = np.where(left & (votes > 0), votes, -1)
        row, column = divmod(int(np.argmax(rim)), rim.shape[1])
        if rim[row, column] <= 0:  # wanted cells out of the reach of all known ones: nearest known cell
            row, column = _nearest_left(left, filled)
        window = np.pad(filled, padded)[row : row + side, column : column + side].reshape(-1)
        target = np.pad(image, (*padded, (0, 0)))[row : row + side, column : column + side]
        seen = np.flatnonzero(window)
        gap = patches[:, seen] - target.reshape(-1, 3)[seen]  # (n, seen, 3)
        cost = np.einsum("npc,npc->n", gap, gap) / max(len(seen), 1)
        best = int(np.argmin(cost + REUSE * scale * used))
        used[best] += 1
        cells = offsets + np.array([row, column])
        inside = ((cells >= 0) & (cells < wanted.shape)).all(axis=1)
        cells, origin = cells[inside], (offsets + middles[best])[inside]
        fresh = left[cells[:, 0], cells[:, 1]]
        cells, origin = cells[fresh], origin[fresh]
        source[cells[:, 0], cells[:, 1]] = origin
        image[cells[:, 0], cells[:, 1]] = image[origin[:, 0], origin[:, 1]]
        filled[cells[:, 0], cells[:, 1]] = True
        left[cells[:, 0], cells[:, 1]] = False
    return source, wanted & filled


def enclosed(known: Bool, cells: Bool, least: int = 6) -> Bool:
    """The given cells from which at least `least` of 8 directions lead to a known cell, (H, W) bool.

    What stood out beyond the rim of a surface is no hole in it.
    """
    from scipy.ndimage import binary_dilation

    met = np.zeros(known.shape, np.int64)
    for direction in (0, 1, 2, 3, 5, 6, 7, 8):  # of the 3 x 3 cells, all but the middle
        step = np.isin(np.arange(9), (4, direction)).reshape(3, 3)
        met += binary_dilation(known, step, iterations=-1)  # until nothing changes
    return np.asarray(cells & (met >= least))


def harmonic_fill(values: Float64, known: Bool, wanted: Bool) -> Float64:
    """(H, W, C) values continued into the wanted cells by Laplace's equation, unknown cells insulating.

    Wanted cells that no known cell borders on, even through others, keep the mean of the known.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import spsolve

    out = np.where(known[..., None], values, 0.0)
    cells = np.argwhere(wanted)
    if not len(cells) or not known.any():
        return out
    number = np.full(wanted.shape, -1)
    number[tuple(cells.T)] = np.arange(len(cells))
    mean = values[known].mean(axis=0)
    diagonal, right = np.full(len(cells), BREATH), np.tile(BREATH * mean, (len(cells), 1))
    rows, columns = [], []
    for step in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        near = cells + step
        inside = ((near >= 0) & (near < wanted.shape)).all(axis=1)
        here, there = np.flatnonzero(inside), near[inside]
        fixed = known[tuple(there.T)]
        right[here[fixed]] += values[tuple(there[fixed].T)]
        diagonal[here[fixed]] += 1.0
        free = number[tuple(there.T)] >= 0
        diagonal[here[free]] += 1.0
        rows.append(here[free])
        columns.append(number[tuple(there[free].T)])
    i, j = np.concatenate([*rows, np.arange(len(cells))]), np.concatenate([*columns, np.arange(len(cells))])
    weights = np.concatenate([np.full(len(i) - len(cells), -1.0), diagonal])
    matrix = coo_matrix((weights, (i, j)), shape=(len(cells), len(cells))).tocsc()
    solved = np.stack([spsolve(matrix, right[:, c]) for c in range(right.shape[1])], axis=1)
    out[tuple(cells.T)] = solved
    return out


def smooth(values: Float64, known: Bool, sigma: float) -> Float64:
    """(H, W, C) Gaussian average of the known cells, sigma in cells; 0 where none is near."""
    from scipy.ndimage import gaussian_filter

    weight = gaussian_filter(known.astype(np.float64), sigma)
    total = gaussian_filter(np.where(known[..., None], values, 0.0), (sigma, sigma, 0.0))
    return np.asarray(np.where(weight[..., None] > 1e-6, total / np.maximum(weight, 1e-6)[..., None], 0.0))


def _source_patches(image: Float64, known: Bool) -> tuple[int, Int64, Float64]:
    """All patches of the largest side that are known throughout: side, (n, 2) middles and (n, side^2, 3) colors."""
    for side in SIDES:
        half = side // 2
        whole = _box_sum(known, half) == side * side
        at = np.argwhere(whole)
        if len(at) >= (FEWEST_SOURCES if side > 1 else 1):
            break
    at = at[:: -(-len(at) // MOST_SOURCES)]
    windows = np.lib.stride_tricks.sliding_window_view(image, (side, side), axis=(0, 1))  # (.., .., 3, s, s)
    patches = windows[at[:, 0] - half, at[:, 1] - half].transpose(0, 2, 3, 1).reshape(len(at), -1, 3)
    return side, at.astype(np.int64), np.ascontiguousarray(patches)


def _box_sum(mask: Bool, half: int) -> Int64:
    """(H, W) number of true cells in the square of side 2 half + 1 about each cell; none beyond the edge."""
    import cv2  # a heavy import that only filling holes pays for

    side = (2 * half + 1, 2 * half + 1)
    sums = cv2.boxFilter(mask.astype(np.uint8), cv2.CV_32S, side, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(sums, dtype=np.int64)


def _nearest_left(left: Bool, filled: Bool) -> tuple[int, int]:
    from scipy.ndimage import distance_transform_edt

    distance = np.where(left, distance_transform_edt(~filled), np.inf)
    row, column = np.unravel_index(int(np.argmin(distance)), left.shape)
    return int(row), int(column)


DISTANCE = 40.0  # the surface is looked at from so many of its half widths: nearly parallel rays

WIDEST_COPY = 0.75
"""Gaussians with a standard deviation above this share of the hole's radius are not copied: no texture of the
hole, they would smear over its rim."""

LEAST_RING = 300  # Gaussians that a ring is widened for

SHOWN, STOOD = 0.05, 0.1
"""Opacity from which a cell shows anything at all, and from which the deleted Gaussians stood in it."""

BASE_COLOR = 3.0
"""Standard deviation, in cells, of the average that is a surface's base color; what is finer is texture."""

ROUNDS = 8  # times the surface is looked at again for cells that the copies so far left open


RING = 0.6  # width of the ring that gives surface and texture, in radii of the hole
CELLS = 96  # most cells across the area looked at; the texture is copied in cells
COVERED = 0.85  # opacity along the normal from which a cell counts as surface, in shares of the ring's own


def inpaint(model: GaussianModel, selection: Bool) -> Edited:
    """Delete the selected Gaussians and fill the hole they leave in the surface around them.

    The Gaussians left come in their order, then the filling (`edit.filling`; None where no surface surrounds the
    hole). Copies carry the marked colors of the Gaussians they come from.
    """
    cut = delete(model, selection)
    rows = np.flatnonzero(selection)
    hole = model.take(rows)
    center = np.median(hole.means.astype(np.float64), axis=0)
    size = float(np.quantile(np.linalg.norm(hole.means - center, axis=1), 0.9))
    size = max(size, float(np.median(hole.scales.max(axis=1))))
    ring = model.take(ring_around(model, selection, RING * size, LEAST_RING))
    surface = fit_surface(ring, hole, size, np.random.default_rng(0))  # 1
    filling = None if surface is None else _fill(cut.model, hole, surface)
    if filling is None:
        return cut
    edit = replace(cut.edit, name="inpaint", filling=filling)
    return Edited(edit.apply(model), edit)


def _fill(left: GaussianModel, hole: GaussianModel, surface: HoleSurface) -> GaussianModel | None:
    from scipy.ndimage import binary_dilation

    frame = _Frame(left, hole, surface)
    color, alpha = frame.see(frame.support)  # 2; (H, W, 3), (H, W)
    usual = float(np.median(alpha[alpha > SHOWN])) if (alpha > SHOWN).any() else 0.0
    if usual == 0.0:
        return None
    known = alpha >= COVERED * usual
    _, footprint = frame.see(frame.place(hole))
    gap = enclosed(known, ~known & binary_dilation(footprint > STOOD))
    # What is copied is the texture; the base color is the rim's, continued.
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
        wanted = gap & (alpha < COVERED * usual)
    return filling


class _Frame:
    """The surface around a hole laid flat: cells of a grid over u and v, and the Gaussians that make it."""

    def __init__(self, left: GaussianModel, hole: GaussianModel, surface: HoleSurface) -> None:
        self.surface = surface
        gap = surface.local(hole.means)
        low, high = np.quantile(gap[:, :2], [0.01, 0.99], axis=0)
        self.middle = 0.5 * (low + high)
        reach = 0.5 * float((high - low).max()) + RING * surface.size
        local = surface.local(left.means)
        inside = (np.abs(local[:, :2] - self.middle) < reach).all(axis=1)
        rows = np.flatnonzero(inside & (np.abs(local[:, 2]) < surface.band))
        # Cells finer than the Gaussians hold no texture of their own, and patches of them too few Gaussians.
        usual = float(np.median(np.sort(left.scales[rows], axis=1)[:, 1])) if len(rows) else 0.0
        self.cells = int(np.clip(2.0 * reach / max(0.5 * usual, 2.0 * reach / CELLS), 16, CELLS))
        self.cell = 2.0 * reach / self.cells
        self.model, self.local = left.take(rows), local[rows]
        self.support = self.place(self.model)
        # In the flat world the surface is the plane z = 0 and the camera looks down on it.
        width = self.cell * self.cells
        eye = np.array([*self.middle, DISTANCE * width / 2])
        focal = DISTANCE / 2 * self.cells
        self.camera: Camera = look_at(eye, [*self.middle, 0.0], [0.0, 1.0, 0.0], focal, self.cells, self.cells)

    def place(self, model: GaussianModel) -> GaussianModel:
        """A model in the flat world: u, v and height as coordinates, base color only."""
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
