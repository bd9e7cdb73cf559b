"""A body: a model embedded in elastic tetrahedra, with a position and a velocity for every lattice point.

Every cube of the lattice is split into six tetrahedra along its diagonal from (0, 0, 0) to (1, 1, 1), one for
each order of the three coordinates (Kuhn's subdivision): neighboring cubes agree on their common face, and the
tetrahedron and barycentric coordinates of a point follow from sorting three numbers. `assemble` puts all bodies of a
world into one set of arrays for the kernels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.spatial import cKDTree

from engine.errors import InputError
from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.attack import check_positive
from engine.lab.sim.physics.deforming import deform_model, interpolate
from engine.lab.sim.vectors import check_triple
from engine.model import Bool, Float64, GaussianModel, Int32, Int64
from engine.numerics.similarity import quaternion_to_rotation

REACH = 2.0  # matter is looked for within this many robust radii of the center
VISIBLE = 0.1  # Gaussians below this share of the largest opacity are not matter; they ride along
ISLAND = 0.02  # islands with less than this share of all voxels are floaters: they ride along with the nearest matter
RESOLUTIONS = (2, 96)  # allowed voxels along the longest extent


@dataclass(frozen=True, eq=False)
class Lattice:
    """The rest shape: P points, T tetrahedra, E edges."""

    points: Float64  # (P, 3) at rest, scene units
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
    hold visible Gaussians (center or one standard deviation along an axis), with closed hollows filled and floating
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


@dataclass(frozen=True)
class Material:
    """What a body is made of. One scene unit is one metre, one unit of mass a kilogram."""

    compliance: float = 2e-5  # of the edges: 1 / Young's modulus, 1/Pa, at least 0. Whatever the resolution.
    volume_compliance: float = 2e-5  # of the tetrahedra's volumes: 1 / bulk modulus, 1/Pa, at least 0
    # of the edges, Pa s, at least 0: takes energy from the rate of strain, not from rigid motion. Strain dies
    # away within about compliance * viscosity seconds where nothing swings.
    viscosity: float = 200.0

    def __post_init__(self) -> None:
        for name in ("compliance", "volume_compliance", "viscosity"):
            check_positive(getattr(self, name), f"{name} of a material", zero=True)


@dataclass(frozen=True, eq=False)
class Body:
    """A model (N Gaussians at rest) and the state of the matter it sits in (P points)."""

    model: GaussianModel
    lattice: Lattice
    binding: Binding
    material: Material
    masses: Float64  # (P,) of the points, kg, positive
    pinned: Bool  # (P,) points that nothing moves (inverse mass zero)
    positions: Float64  # (P, 3) now, scene units
    velocities: Float64  # (P, 3) now, scene units per second

    @property
    def inverse_masses(self) -> Float64:
        """(P,) 1/kg, zero where pinned."""
        return np.where(self.pinned, 0.0, 1.0 / self.masses)


def make_body(
    model: GaussianModel,
    *,
    resolution: int = 16,
    density: float = 200.0,
    material: Material | None = None,
    pinned: npt.NDArray[np.bool_] | None = None,
    velocity: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> Body:
    """Fill a model with matter; its Gaussians keep their number, order and opacity whatever happens.

    `resolution` is the number of voxels along the longest robust extent, 2 to 96, each of six tetrahedra; `density` is
    positive, in kg per cubic scene unit; `pinned` (N,) marks Gaussians whose tetrahedra's corners never move;
    `velocity` (3,) is that at the start, scene units per second.
    """
    check_positive(density, "density")
    start = check_triple(velocity, "velocity")
    lattice, binding = build_lattice(model, resolution)
    fixed = np.zeros(len(lattice.points), dtype=bool)
    if pinned is not None:
        if pinned.shape != (len(model),) or pinned.dtype != bool:
            raise InputError(f"pinned must be {len(model)} booleans, got {pinned.dtype} {pinned.shape}")
        fixed[lattice.tets[binding.tet[pinned]]] = True
    share = density * lattice.tet_volume / 4.0
    corners = np.bincount(lattice.tets.ravel(), minlength=len(lattice.points))
    masses: Float64 = share * corners.astype(np.float64)
    velocities: Float64 = np.where(fixed[:, None], 0.0, start)
    return Body(model, lattice, binding, material or Material(), masses, fixed, lattice.points.copy(), velocities)


def pose(body: Body) -> GaussianModel:
    """The deformed model: a model as any other, to be rendered, written, verified.

    Means by barycentric interpolation; covariances F Sigma F^T and SH turned by the rotation part of F, F being the
    deformation gradient of the Gaussian's tetrahedron (Eq 12).
    """
    return deform_model(
        body.model, kernel_means(body).astype(np.float32), deformation_gradients(body), body.binding.tet
    )


def kernel_means(body: Body) -> Float64:
    """(N, 3) where the Gaussians' centers are now, scene units."""
    return _interpolated(body, body.positions)


def kernel_velocities(body: Body) -> Float64:
    """(N, 3) velocities of the Gaussians, scene units per second."""
    return _interpolated(body, body.velocities)


def deformation_gradients(body: Body) -> Float64:
    """(T, 3, 3) deformation gradients F = Ds Dm^-1 of the tetrahedra (Eq 12)."""
    corners = body.positions[body.lattice.tets]  # (T, 4, 3)
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)  # columns are edges
    return np.asarray(edges @ body.lattice.inverse_rest)


def kernel_strains(body: Body) -> Float64:
    """(N, 3, 3) Green strain (F^T F - 1) / 2 of the Gaussians' surroundings."""
    F = deformation_gradients(body)  # (T, 3, 3)
    strains = 0.5 * (F.transpose(0, 2, 1) @ F - np.eye(3))
    return np.asarray(strains[body.binding.tet])


def strain_norms(body: Body) -> Float64:
    """(N,) Frobenius norms of the Gaussians' Green strains: 0 for any rigid motion."""
    return np.asarray(np.linalg.norm(kernel_strains(body), axis=(1, 2)))


def color_by_strain(body: Body, full: float = 0.5) -> GaussianModel:
    """The deformed model in degree 0, its strain as color: matplotlib's "viridis", yellow from a norm of `full` on."""
    from matplotlib import colormaps

    from engine.model import SH_C0

    check_positive(full, "the strain of full color")
    colors: npt.NDArray[Any] = colormaps["viridis"](np.clip(strain_norms(body) / full, 0.0, 1.0))[:, :3]
    posed = pose(replace(body, model=body.model.with_(sh=body.model.sh[:, :1])))
    return posed.with_dc(((colors - 0.5) / SH_C0).astype(np.float32))


def _interpolated(body: Body, values: Float64) -> Float64:
    out = np.empty((len(body.model), 3))
    interpolate(values, body.lattice.tets, body.binding.tet, body.binding.weights, out)
    return out


CONTACT = 0.45
"""Radius of a point in contacts, in cells: neighbors at rest are 1 cell apart and stay clear of each other."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """P points, E edges and T tetrahedra of B bodies; units as in `Body`."""

    positions: Float64  # (P, 3); a copy, to be moved in place
    velocities: Float64  # (P, 3); a copy, too
    rest: Float64  # (P, 3)
    masses: Float64  # (P,)
    inverse_masses: Float64  # (P,)
    radii: Float64  # (P,)
    body: Int32  # (P,) to which body a point belongs
    firsts: Int64  # (B + 1,) where each body's points begin and the last one's end
    free: Bool  # (B,) whether nothing of a body is pinned
    surface: Int64  # (S,) points on the outside
    reach: float  # largest sum of two radii
    edges: Int32  # (E, 2)
    edge_compliance: Float64  # (E,) m/N
    edge_damping: Float64  # (E,) N s/m
    tets: Int32  # (T, 4)
    volumes: Float64  # (T,) cubic scene units
    tet_compliance: Float64  # (T,) m^3/Pa


def assemble(bodies: Sequence[Body]) -> Assembly:
    """Put the bodies one after the other; stiffnesses become the same whatever the resolution.

    An edge of length L stands for a rod of cross-section cell^2, so its compliance is L / (E cell^2) and its
    dashpot has viscosity * cell^2 / L; a tetrahedron's volume has V / K, the bulk energy being K (V - V0)^2 / (2 V0).
    """
    counts, tets = [len(b.positions) for b in bodies], [len(b.lattice.tets) for b in bodies]
    firsts = np.cumsum([0, *counts]).astype(np.int64)
    placed = list(zip(firsts[:-1], bodies, strict=True))
    edge_compliance, edge_damping = [], []
    for body in bodies:
        lattice = body.lattice
        ends = lattice.points[lattice.edges]  # (E, 2, 3)
        lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        edge_compliance.append(body.material.compliance * lengths / lattice.cell**2)
        edge_damping.append(body.material.viscosity * lattice.cell**2 / lengths)

    def spread(values: Sequence[float], sizes: Sequence[int]) -> Float64:
        return np.repeat(np.asarray(values, dtype=np.float64), sizes)

    return Assembly(
        positions=np.concatenate([b.positions for b in bodies]),
        velocities=np.concatenate([b.velocities for b in bodies]),
        rest=np.concatenate([b.lattice.points for b in bodies]),
        masses=np.concatenate([b.masses for b in bodies]),
        inverse_masses=np.concatenate([b.inverse_masses for b in bodies]),
        radii=spread([CONTACT * b.lattice.cell for b in bodies], counts),
        body=np.repeat(np.arange(len(bodies), dtype=np.int32), counts),
        firsts=firsts,
        free=np.array([not b.pinned.any() for b in bodies]),
        surface=np.concatenate([first + np.flatnonzero(b.lattice.surface) for first, b in placed]),
        reach=2.0 * CONTACT * max(b.lattice.cell for b in bodies),
        edges=np.concatenate([b.lattice.edges + np.int32(first) for first, b in placed]),
        edge_compliance=np.concatenate(edge_compliance),
        edge_damping=np.concatenate(edge_damping),
        tets=np.concatenate([b.lattice.tets + np.int32(first) for first, b in placed]),
        volumes=spread([b.lattice.tet_volume for b in bodies], tets),
        tet_compliance=spread([b.material.volume_compliance * b.lattice.tet_volume for b in bodies], tets),
    )
