"""Energy of a world, against which its steps are held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.lab.sim.physics.body import assemble
from engine.lab.sim.physics.world import World
from engine.model import Float64


@dataclass(frozen=True)
class Energy:
    """Joule, with a scene unit for a metre."""

    kinetic: float
    potential: float  # in the field of gravity, zero at the origin
    elastic: float  # of edges, volumes and clusters; what is infinitely stiff stores none

    @property
    def total(self) -> float:
        """All three."""
        return self.kinetic + self.potential + self.elastic


def energy(world: World) -> Energy:
    """Energy of all bodies."""
    parts = assemble(world.bodies)
    x, v, m = parts.positions, parts.velocities, parts.masses
    kinetic = 0.5 * float(m @ (v * v).sum(axis=1))
    potential = -float(m @ (x @ world.gravity))

    ends, rest = x[parts.edges], parts.rest[parts.edges]
    lengths, at_rest = (np.linalg.norm(e[:, 0] - e[:, 1], axis=1) for e in (ends, rest))
    elastic = _stored(lengths - at_rest, parts.edge_compliance)
    corners = x[parts.tets]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    elastic += _stored(volumes - parts.volumes, parts.tet_compliance)
    for number, rate in enumerate(parts.cluster_rates):
        members = parts.cluster_members[parts.cluster_starts[number] : parts.cluster_starts[number + 1]]
        away = _away_from_rigid(x[members], parts.rest[members], m[members])
        elastic += 0.5 * rate * rate * float(m[members] @ (away * away).sum(axis=1))
    return Energy(kinetic, potential, elastic)


def _stored(violations: Float64, compliance: Float64) -> float:
    soft = compliance > 0
    return 0.5 * float((violations[soft] ** 2 / compliance[soft]).sum())


def _away_from_rigid(x: Float64, rest: Float64, masses: Float64) -> Float64:
    """(M, 3) from each point of a cluster to its place in the best rigid placement (Kabsch)."""
    total = masses.sum()
    center, rest_center = masses @ x / total, masses @ rest / total
    u, _, vt = np.linalg.svd((x - center).T @ (masses[:, None] * (rest - rest_center)))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.asarray(center + (rest - rest_center) @ turn.T - x)
