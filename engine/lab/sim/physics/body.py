"""A body: a model embedded in elastic tetrahedra, with a position and a velocity for every lattice point."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.attack import check_positive
from engine.lab.sim.physics.deforming import deform_model, interpolate
from engine.lab.sim.physics.lattice import Binding, Lattice, build_lattice
from engine.lab.sim.vectors import check_triple
from engine.model import Bool, Float64, GaussianModel

__all__ = [
    "Body",
    "Material",
    "color_by_strain",
    "deformation_gradients",
    "kernel_strains",
    "kernel_velocities",
    "make_body",
    "pose",
    "strain_norms",
]


@dataclass(frozen=True)
class Material:
    """What a body is made of. One scene unit is one metre, one unit of mass a kilogram."""

    compliance: float = 2e-5  # of the edges: 1 / Young's modulus, 1/Pa, at least 0. Whatever the resolution.
    volume_compliance: float = 2e-5  # of the tetrahedra's volumes: 1 / bulk modulus, 1/Pa, at least 0
    # how fast points are drawn to the best rigid placement of their cluster, 1/s; 0 matches no shape
    shape_rate: float = 0.0
    # side of a cluster in cells; 0 makes one cluster of the whole body, so that a high rate makes it rigid
    shape_cluster: int = 0
    # of the edges, Pa s, at least 0: takes energy from the rate of strain, not from rigid motion. Strain dies
    # away within about compliance * viscosity seconds where nothing swings.
    viscosity: float = 200.0

    def __post_init__(self) -> None:
        for name in ("compliance", "volume_compliance", "shape_rate", "shape_cluster", "viscosity"):
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
    """(N, 3) where the Gaussians' centres are now, scene units."""
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
    """The deformed model in degree 0, its strain as colour: matplotlib's "viridis", yellow from a norm of `full` on."""
    from matplotlib import colormaps

    from engine.model import SH_C0

    check_positive(full, "the strain of full colour")
    colors: npt.NDArray[Any] = colormaps["viridis"](np.clip(strain_norms(body) / full, 0.0, 1.0))[:, :3]
    posed = pose(replace(body, model=body.model.with_(sh=body.model.sh[:, :1])))
    return posed.with_dc(((colors - 0.5) / SH_C0).astype(np.float32))


def _interpolated(body: Body, values: Float64) -> Float64:
    out = np.empty((len(body.model), 3))
    interpolate(values, body.lattice.tets, body.binding.tet, body.binding.weights, out)
    return out
