"""All bodies of a world in one set of arrays, as the kernels want them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.model import Bool, Float64, Int32, Int64
from engine.sim.physics.body import Body

__all__ = ["Assembly", "assemble"]

CONTACT = 0.45
"""Radius of a point in contacts, in cells: neighbours at rest are 1 cell apart and stay clear of each other."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """P points, E edges, T tetrahedra and C clusters of several bodies; units as in `Body`.

    Parameters
    ----------
    positions, velocities, rest : (P, 3) float64
        The first two are copies, to be moved in place.
    masses, inverse_masses, radii : (P,) float64
    body : (P,) int32
        To which body a point belongs.
    firsts : (B + 1,) int64
        Where each body's points begin and the last one's end.
    free : (B,) bool
        Whether nothing of a body is pinned.
    surface : (S,) int64
        Points on the outside.
    reach : float
        Largest sum of two radii.
    edges : (E, 2) int32
    edge_compliance, edge_damping : (E,) float64
        m/N and N s/m.
    tets : (T, 4) int32
    volumes, tet_compliance : (T,) float64
        Cubic scene units and m^3/Pa.
    cluster_members : (M,) int64
    cluster_starts : (C + 1,) int64
    cluster_rates : (C,) float64
        1/s; clusters of bodies that match no shape are left out.
    """

    positions: Float64
    velocities: Float64
    rest: Float64
    masses: Float64
    inverse_masses: Float64
    radii: Float64
    body: Int32
    firsts: Int64
    free: Bool
    surface: Int64
    reach: float
    edges: Int32
    edge_compliance: Float64
    edge_damping: Float64
    tets: Int32
    volumes: Float64
    tet_compliance: Float64
    cluster_members: Int64
    cluster_starts: Int64
    cluster_rates: Float64


def assemble(bodies: Sequence[Body]) -> Assembly:
    """Put the bodies one after the other; stiffnesses become the same whatever the resolution.

    An edge of length L stands for a rod of cross-section cell^2, so its compliance is L / (E cell^2) and its
    dashpot has viscosity * cell^2 / L; a tetrahedron's volume has V / K, the bulk energy being K (V - V0)^2 / (2 V0).
    """
    firsts = np.cumsum([0, *(len(b.positions) for b in bodies)]).astype(np.int64)
    counts = [len(b.positions) for b in bodies]
    edge_compliance, edge_damping, members, starts, rates = [], [], [], [0], []
    for first, body in zip(firsts, bodies, strict=False):
        lattice = body.lattice
        ends = lattice.points[lattice.edges]
        lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        edge_compliance.append(body.material.compliance * lengths / lattice.cell**2)
        edge_damping.append(body.material.viscosity * lattice.cell**2 / lengths)
        if body.material.shape_rate > 0:
            for cluster in clusters(body):
                members.append(first + cluster)
                starts.append(starts[-1] + len(cluster))
                rates.append(body.material.shape_rate)

    def spread(values: Sequence[float], sizes: Sequence[int]) -> Float64:
        return np.repeat(np.asarray(values, dtype=np.float64), sizes)

    tets = [len(b.lattice.tets) for b in bodies]
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
        surface=np.concatenate(
            [first + np.flatnonzero(b.lattice.surface) for first, b in zip(firsts, bodies, strict=False)]
        ),
        reach=2.0 * CONTACT * max(b.lattice.cell for b in bodies),
        edges=np.concatenate([b.lattice.edges + np.int32(first) for first, b in zip(firsts, bodies, strict=False)]),
        edge_compliance=np.concatenate(edge_compliance),
        edge_damping=np.concatenate(edge_damping),
        tets=np.concatenate([b.lattice.tets + np.int32(first) for first, b in zip(firsts, bodies, strict=False)]),
        volumes=spread([b.lattice.tet_volume for b in bodies], tets),
        tet_compliance=spread([b.material.volume_compliance * b.lattice.tet_volume for b in bodies], tets),
        cluster_members=np.concatenate(members) if members else np.zeros(0, dtype=np.int64),
        cluster_starts=np.array(starts, dtype=np.int64),
        cluster_rates=np.array(rates, dtype=np.float64),
    )


def clusters(body: Body) -> list[Int64]:
    """Points of each shape-matching cluster: disjoint blocks of the lattice, or the whole body."""
    side = body.material.shape_cluster
    if side == 0:
        return [np.arange(len(body.positions))]
    blocks = body.lattice.sites // side
    _, label = np.unique(blocks, axis=0, return_inverse=True)
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
