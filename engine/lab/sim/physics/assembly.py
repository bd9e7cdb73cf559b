"""All bodies of a world in one set of arrays, as the kernels want them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.lab.sim.physics.body import Body
from engine.model import Bool, Float64, Int32, Int64

__all__ = ["Assembly", "assemble"]

CONTACT = 0.45
"""Radius of a point in contacts, in cells: neighbours at rest are 1 cell apart and stay clear of each other."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """P points, E edges, T tetrahedra and C clusters of B bodies; units as in `Body`."""

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
    cluster_members: Int64  # (M,)
    cluster_starts: Int64  # (C + 1,)
    cluster_rates: Float64  # (C,) 1/s; clusters of bodies that match no shape are left out


def assemble(bodies: Sequence[Body]) -> Assembly:
    """Put the bodies one after the other; stiffnesses become the same whatever the resolution.

    An edge of length L stands for a rod of cross-section cell^2, so its compliance is L / (E cell^2) and its
    dashpot has viscosity * cell^2 / L; a tetrahedron's volume has V / K, the bulk energy being K (V - V0)^2 / (2 V0).
    """
    counts, tets = [len(b.positions) for b in bodies], [len(b.lattice.tets) for b in bodies]
    firsts = np.cumsum([0, *counts]).astype(np.int64)
    placed = list(zip(firsts[:-1], bodies, strict=True))
    edge_compliance, edge_damping, members, starts, rates = [], [], [], [0], []
    for first, body in placed:
        lattice = body.lattice
        ends = lattice.points[lattice.edges]  # (E, 2, 3)
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
