"""Matter for a model: tetrahedra in its occupied voxels, and where each Gaussian sits in them.

Every cube of the lattice is split into six tetrahedra along its diagonal from (0, 0, 0) to (1, 1, 1), one for
each order of the three coordinates (Kuhn's subdivision): neighbouring cubes agree on their common face, and the
tetrahedron and barycentric coordinates of a point follow from sorting three numbers.
"""

from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.spatial import cKDTree

from engine.errors import InputError
from engine.flows.views.camera_rig import measure_extent
from engine.model import Bool, Float64, GaussianModel, Int32, Int64
from engine.numerics.similarity import quaternion_to_rotation

__all__ = ["Binding", "Lattice", "build_lattice"]

REACH = 2.0
"""Matter is looked for within this many robust radii of the centre."""
VISIBLE = 0.1
"""Gaussians below this share of the largest opacity are not matter; they ride along."""
ISLAND = 0.02
"""Islands with less than this share of all voxels are floaters: they ride along with the nearest matter."""
RESOLUTIONS = (2, 96)
"""Allowed voxels along the longest extent."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """The rest shape: P points, T tetrahedra, E edges."""

    points: Float64  # (P, 3) at rest, scene units
    sites: Int64  # (P, 3) the same in whole cells
    tets: Int32  # (T, 4) corners; volumes are positive at rest
    edges: Int32  # (E, 2) every edge of a tetrahedron once, sorted
    surface: Bool  # (P,) whether a point lies on the outside
    cell: float  # side of a voxel, scene units
    inverse_rest: Float64  # (T, 3, 3) inverse of the rest edges Dm = [x1-x0, x2-x0, x3-x0] (Eq 12), 1 / scene units

    @property
    def tet_volume(self) -> float:
        """Rest volume of every tetrahedron."""
        return self.cell**3 / 6.0


@dataclass(frozen=True, eq=False)
class Binding:
    """Where N Gaussians sit: in tetrahedron `tet` with barycentric `weights`."""

    tet: Int32  # (N,)
    weights: Float64  # (N, 4) sum 1; some are negative for Gaussians outside of all matter, bound to the nearest


def build_lattice(model: GaussianModel, resolution: int) -> tuple[Lattice, Binding]:
    """Fill the model with tetrahedra and bind every Gaussian to them.

    `resolution` is the number of voxels along the model's longest robust extent, 2 to 96. Matter is in the voxels that
    hold visible Gaussians (centre or one standard deviation along an axis), with closed hollows filled and floating
    islands left out. InputError if the model is empty or the resolution is out of range.
    """
    low, high = RESOLUTIONS
    if not low <= resolution <= high:
        raise InputError(f"a lattice takes {low} to {high} voxels along the model, got {resolution}")
    if len(model) == 0:
        raise InputError("a body needs a model that is not empty")
    extent = measure_extent(model)
    cell = max(float(extent.axes.max()), extent.radius) / int(resolution)
    origin = extent.center - REACH * extent.radius
    voxels = _occupied_voxels(model, origin, cell, 2.0 * REACH * extent.radius, extent.center)
    lattice = _tetrahedra(voxels, origin, cell)
    return lattice, _bind(model.means.astype(np.float64), voxels, origin, cell)


def _occupied_voxels(model: GaussianModel, origin: Float64, cell: float, width: float, center: Float64) -> Int64:
    """(V, 3) voxels of matter, sorted; at least one."""
    shown = model.take(model.opacities >= VISIBLE * model.opacities.max())
    means = shown.means.astype(np.float64)
    axes = quaternion_to_rotation(shown.quats) * shown.scales.astype(np.float64)[:, None, :]
    samples = np.concatenate([means, *(means + sign * axes[:, :, k] for sign in (-1, 1) for k in range(3))])
    sites = np.floor((samples - origin) / cell)
    side = int(np.ceil(width / cell)) + 1
    near = ((sites >= 0) & (sites < side)).all(axis=1)
    if not near.any():
        return np.floor((center - origin) / cell).astype(np.int64)[None]
    grid = np.zeros((side, side, side), dtype=bool)
    grid[tuple(sites[near].astype(np.int64).T)] = True
    islands, _ = ndimage.label(grid, structure=np.ones((3, 3, 3)))
    sizes = np.bincount(islands.ravel())
    sizes[0] = 0
    kept = sizes >= min(ISLAND * sizes.sum(), sizes.max())
    kept[0] = False
    return np.argwhere(ndimage.binary_fill_holes(kept[islands])).astype(np.int64)


def _orders() -> tuple[Int64, Int64]:
    """Per order of the coordinates: its corners (6, 4, 3), and the slot of each barycentric weight (6, 4)."""
    corners, slots = [], []
    for order in permutations(range(3)):
        path = np.concatenate([np.zeros((1, 3)), np.cumsum(np.eye(3)[list(order)], axis=0)])
        slot = np.arange(4)
        if np.linalg.det(path[1:]) < 0:  # keep volumes positive
            slot[[2, 3]] = slot[[3, 2]]
        corners.append(path[slot])
        slots.append(slot)
    return np.array(corners, dtype=np.int64), np.array(slots)


CORNERS, SLOTS = _orders()


def _tetrahedra(voxels: Int64, origin: Float64, cell: float) -> Lattice:
    corners = voxels[:, None, None, :] + CORNERS  # (V, 6, 4, 3)
    sites, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    tets = index.reshape(-1, 4).astype(np.int32)
    pairs = np.concatenate([tets[:, [a, b]] for a in range(4) for b in range(a + 1, 4)])
    edges = np.unique(np.sort(pairs, axis=1), axis=0)
    cubes = np.array(list(np.ndindex(2, 2, 2)))
    _, used = np.unique((voxels[:, None, :] + cubes).reshape(-1, 3), axis=0, return_counts=True)
    rest = CORNERS.astype(np.float64) * cell
    inverse = np.linalg.inv((rest[:, 1:] - rest[:, :1]).transpose(0, 2, 1))  # columns are edges
    return Lattice(
        points=origin + cell * sites,
        sites=sites,
        tets=tets,
        edges=edges,
        surface=used < len(cubes),
        cell=cell,
        inverse_rest=np.tile(inverse, (len(voxels), 1, 1)),
    )


def _bind(means: Float64, voxels: Int64, origin: Float64, cell: float) -> Binding:
    position = (means - origin) / cell
    own = _row_of(voxels, np.floor(position))
    outside = np.flatnonzero(own < 0)
    if len(outside):
        _, own[outside] = cKDTree(voxels + 0.5).query(position[outside])
    fraction = position - voxels[own]  # (N, 3), beyond 0..1 for those outside
    order = np.argsort(-fraction, axis=1, kind="stable")  # (N, 3)
    kind = 2 * order[:, 0] + (order[:, 1] > order[:, 2])  # its number among the permutations of 0, 1, 2
    steps = np.take_along_axis(fraction, order, axis=1)
    along = np.column_stack([1.0 - steps[:, 0], -np.diff(steps, axis=1), steps[:, 2]])
    weights = np.take_along_axis(along, SLOTS[kind], axis=1)  # (N, 4)
    return Binding((6 * own + kind).astype(np.int32), weights)


def _row_of(voxels: Int64, sites: npt.NDArray[Any]) -> Int64:
    """Row of each site among the sorted voxels, -1 where it is none of them."""
    side = int(voxels.max()) + 1
    inside: Bool = np.all((sites >= 0) & (sites < side), axis=1)
    scale = np.array([side * side, side, 1])
    keys = voxels @ scale
    wanted = np.where(inside[:, None], sites, 0).astype(np.int64) @ scale
    row = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    found: Int64 = np.where(inside & (keys[row] == wanted), row, -1)
    return found
