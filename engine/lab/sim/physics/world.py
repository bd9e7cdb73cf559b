"""A world of bodies and obstacles, its step (extended position-based dynamics, small substeps), and its energy."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from engine.errors import InputError
from engine.lab.sim.attack import check_positive
from engine.lab.sim.physics import xpbd_kernels as constraints
from engine.lab.sim.physics import xpbd_kernels as contacts
from engine.lab.sim.physics.body import Assembly, Body, assemble
from engine.lab.sim.vectors import check_triple
from engine.model import Float64

STEP = 1.0 / 60.0  # default length of a step, seconds


EARTH = (0.0, -9.81, 0.0)  # gravity where a scene unit is a metre and y is up


def _make_vectors(owner: object, what: str, *names: str) -> None:
    """Fields of a frozen object made (3,) float64."""
    for name in names:
        object.__setattr__(owner, name, check_triple(getattr(owner, name), f"{name}{what}"))


@dataclass(frozen=True, eq=False)
class Plane:
    """A wall: matter stays on the side its normal shows to."""

    point: Float64  # (3,) on the plane now, scene units
    normal: Float64  # (3,) towards the free side; made a unit vector
    # (3,) of the plane, scene units per second: a lid that presses, a conveyor that carries
    velocity: Float64 = field(default_factory=lambda: np.zeros(3))
    friction: float = 0.5  # Coulomb's coefficient, at least 0

    def __post_init__(self) -> None:
        _make_vectors(self, " of a plane", "point", "normal", "velocity")
        length = float(np.linalg.norm(self.normal))
        if not length > 0:
            raise InputError("the normal of a plane is zero")
        object.__setattr__(self, "normal", self.normal / length)
        check_positive(self.friction, "friction of a plane", zero=True)


@dataclass(frozen=True, eq=False)
class Sphere:
    """A ball that matter stays out of; units as of a `Plane`, `center` as it is now."""

    center: Float64
    radius: float
    velocity: Float64 = field(default_factory=lambda: np.zeros(3))
    friction: float = 0.5

    def __post_init__(self) -> None:
        _make_vectors(self, " of a sphere", "center", "velocity")
        check_positive(self.radius, "the radius of a sphere")
        check_positive(self.friction, "friction of a sphere", zero=True)


@dataclass(frozen=True, eq=False)
class World:
    """Bodies, what acts on them, and how finely time is cut."""

    bodies: tuple[Body, ...]  # at least one
    gravity: Float64 = field(default_factory=lambda: np.array(EARTH))  # (3,) scene units per second squared
    planes: tuple[Plane, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    drag: float = 0.0  # rate at which all motion dies away, 1/s, at least 0; 0 is vacuum
    # parts of a step, each with one pass over all constraints. More make bodies stiffer and motion livelier.
    substeps: int = 30
    collide: bool = True  # whether bodies collide with each other and with themselves
    time: float = 0.0  # seconds since the start

    def __post_init__(self) -> None:
        if not self.bodies:
            raise InputError("a world needs at least one body")
        _make_vectors(self, "", "gravity")
        check_positive(self.drag, "drag", zero=True)
        if self.substeps < 1:
            raise InputError(f"a step has at least one substep, got {self.substeps}")


def step(world: World, dt: float = STEP) -> World:
    """The world `dt` > 0 seconds later: all bodies, and planes and spheres that move.

    Notes
    -----
    Macklin, Mueller and Chentanez, "XPBD", MIG 2016; Macklin et al., "Small Steps in Physics Simulation", SCA
    2019; contacts after Macklin et al., "Unified Particle Physics for Real-Time Applications", 2014. The same
    world gives the same bytes, whatever the thread count.
    """
    if not (np.isfinite(dt) and dt > 0):
        raise InputError(f"a step takes a positive time, got {dt}")
    parts = assemble(world.bodies)
    x, v = parts.positions, parts.velocities
    for number in range(world.substeps):
        _substep(world, parts, x, v, dt / world.substeps, number)
    ends = zip(world.bodies, parts.firsts[:-1], parts.firsts[1:], strict=True)
    moved = [replace(body, positions=x[a:b].copy(), velocities=v[a:b].copy()) for body, a, b in ends]
    return replace(
        world,
        bodies=tuple(moved),
        planes=tuple(replace(p, point=p.point + dt * p.velocity) for p in world.planes),
        spheres=tuple(replace(s, center=s.center + dt * s.velocity) for s in world.spheres),
        time=world.time + dt,
    )


def _substep(world: World, parts: Assembly, x: Float64, v: Float64, h: float, number: int) -> None:
    """One substep of h seconds, in place.

    1. Move freely.                                    5. Points out of the obstacles: theirs is the last word.
    2. Points out of the obstacles.                    6. Velocities from the way gone.
    3. Elastic, one pass.                              7. Damping of the rate of strain.
    4. Points out of each other's way.

    By 2 the elastic answers an impact within the substep.
    """
    w, now, backward = parts.inverse_masses, (number + 1) * h, number % 2 == 1
    x_prev = np.empty_like(x)
    constraints.predict(x, x_prev, v, w, world.gravity, float(np.exp(-world.drag * h)), h)  # 1
    _keep_out(world, x, x_prev, w, now, h)  # 2
    spins, lost = np.empty((len(world.bodies), 3)), np.empty((len(world.bodies), 3))
    constraints.measure_spins(x, x_prev, parts.masses, parts.firsts, spins)
    constraints.project_distances(x, w, parts.edges, parts.rest, parts.edge_compliance, h, backward)  # 3
    constraints.project_volumes(x, w, parts.tets, parts.volumes, parts.tet_compliance, h, backward)
    constraints.restore_spins(x, x_prev, parts.masses, parts.firsts, parts.free, spins, lost)
    if world.collide:  # 4
        pairs = contacts.find_pairs(x, parts.rest, parts.surface, parts.body, parts.radii, parts.reach)
        if len(pairs):
            contacts.collide_pairs(x, x_prev, w, pairs, parts.radii)
    _keep_out(world, x, x_prev, w, now, h)  # 5
    constraints.update_velocities(x, x_prev, v, w, h)  # 6
    constraints.damp_velocities(x, v, w, parts.edges, parts.edge_damping, h, backward)  # 7


def _keep_out(world: World, x: Float64, x_prev: Float64, w: Float64, now: float, h: float) -> None:
    """Move points out of all obstacles as they are `now` seconds after the world's time; planes have the last word."""
    for s in world.spheres:
        center, flow = s.center + now * s.velocity, h * s.velocity
        contacts.collide_sphere(x, x_prev, w, center, float(s.radius), flow, float(s.friction))
    for p in world.planes:
        point, flow = p.point + now * p.velocity, h * p.velocity
        contacts.collide_plane(x, x_prev, w, point, p.normal, flow, float(p.friction))


@dataclass(frozen=True)
class Energy:
    """Joule, with a scene unit for a metre."""

    kinetic: float
    potential: float  # in the field of gravity, zero at the origin
    elastic: float  # of edges and volumes; what is infinitely stiff stores none

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
    return Energy(kinetic, potential, elastic)


def _stored(violations: Float64, compliance: Float64) -> float:
    soft = compliance > 0
    return 0.5 * float((violations[soft] ** 2 / compliance[soft]).sum())
