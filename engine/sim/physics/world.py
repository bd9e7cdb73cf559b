"""A world of bodies and obstacles, and its step: extended position-based dynamics with small substeps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float64
from engine.sim.physics import constraint_kernels as constraints
from engine.sim.physics import contact_kernels as contacts
from engine.sim.physics.assembly import Assembly, assemble
from engine.sim.physics.body import Body

__all__ = ["Plane", "Sphere", "World", "ground", "step"]

STEP = 1.0 / 60.0
"""Default length of a step, seconds."""


def _vector(value: npt.ArrayLike, what: str) -> Float64:
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{what} must be three finite numbers, got {value!r}")
    return vector


def _not_negative(value: float, what: str) -> None:
    if not (np.isfinite(value) and value >= 0):
        raise InputError(f"{what} must be finite and not negative, got {value}")


@dataclass(frozen=True, eq=False)
class Plane:
    """A wall: matter stays on the side its normal shows to.

    Parameters
    ----------
    point : (3,)
        On the plane now, scene units.
    normal : (3,)
        Towards the free side; made a unit vector.
    velocity : (3,)
        Of the plane, scene units per second: a lid that presses, a conveyor that carries.
    friction : float
        Coulomb's coefficient, at least 0.
    """

    point: Float64
    normal: Float64
    velocity: Float64 = (0.0, 0.0, 0.0)  # type: ignore[assignment]  # made an array below
    friction: float = 0.5

    def __post_init__(self) -> None:
        for name in ("point", "normal", "velocity"):
            object.__setattr__(self, name, _vector(getattr(self, name), f"{name} of a plane"))
        length = float(np.linalg.norm(self.normal))
        if not length > 0:
            raise InputError("the normal of a plane is zero")
        object.__setattr__(self, "normal", self.normal / length)
        _not_negative(self.friction, "friction of a plane")


@dataclass(frozen=True, eq=False)
class Sphere:
    """A ball that matter stays out of.

    Parameters
    ----------
    center : (3,)
        Now, scene units.
    radius : float
        Positive, scene units.
    velocity : (3,)
        Scene units per second.
    friction : float
        Coulomb's coefficient, at least 0.
    """

    center: Float64
    radius: float
    velocity: Float64 = (0.0, 0.0, 0.0)  # type: ignore[assignment]  # made an array below
    friction: float = 0.5

    def __post_init__(self) -> None:
        for name in ("center", "velocity"):
            object.__setattr__(self, name, _vector(getattr(self, name), f"{name} of a sphere"))
        if not (np.isfinite(self.radius) and self.radius > 0):
            raise InputError(f"the radius of a sphere must be positive and finite, got {self.radius}")
        _not_negative(self.friction, "friction of a sphere")


@dataclass(frozen=True, eq=False)
class World:
    """Bodies, what acts on them, and how finely time is cut.

    Parameters
    ----------
    bodies : tuple of Body
        At least one.
    gravity : (3,)
        Scene units per second squared.
    planes : tuple of Plane
    spheres : tuple of Sphere
    drag : float
        Rate at which all motion dies away, 1/s, at least 0; 0 is vacuum.
    substeps : int
        Parts of a step, each with one pass over all constraints. More make bodies stiffer and motion livelier.
    collide : bool
        Whether bodies collide with each other and with themselves.
    time : float
        Seconds since the start.
    """

    bodies: tuple[Body, ...]
    gravity: Float64 = (0.0, -9.81, 0.0)  # type: ignore[assignment]  # made an array below
    planes: tuple[Plane, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    drag: float = 0.0
    substeps: int = 20
    collide: bool = True
    time: float = 0.0

    def __post_init__(self) -> None:
        if not self.bodies:
            raise InputError("a world needs at least one body")
        object.__setattr__(self, "gravity", _vector(self.gravity, "gravity"))
        _not_negative(self.drag, "drag")
        if self.substeps < 1:
            raise InputError(f"a step has at least one substep, got {self.substeps}")


def ground(height: float, up: npt.ArrayLike = (0.0, 1.0, 0.0), friction: float = 0.5) -> Plane:
    """Level ground at a height along `up`."""
    direction = _vector(up, "up")
    return Plane(
        height * direction / max(float(np.linalg.norm(direction)), 1e-300), direction, friction=friction
    )


def step(world: World, dt: float = STEP) -> World:
    """The world `dt` seconds later.

    Parameters
    ----------
    world : World
    dt : float
        Seconds, positive.

    Returns
    -------
    World
        New positions and velocities of all bodies; moving planes and spheres have moved on.

    Raises
    ------
    InputError
        If dt is not positive and finite.

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
    h = dt / world.substeps
    for number in range(world.substeps):
        _substep(world, parts, x, v, h, number)
    moved, at = [], 0
    for body in world.bodies:
        points = slice(at, at + len(body.positions))
        moved.append(replace(body, positions=x[points].copy(), velocities=v[points].copy()))
        at = points.stop
    return replace(
        world,
        bodies=tuple(moved),
        planes=tuple(replace(p, point=p.point + dt * p.velocity) for p in world.planes),
        spheres=tuple(replace(s, center=s.center + dt * s.velocity) for s in world.spheres),
        time=world.time + dt,
    )


def _substep(world: World, parts: Assembly, x: Float64, v: Float64, h: float, number: int) -> None:
    """One substep of h seconds, in place: predict, elastic, contacts, velocities. Obstacles have the last word."""
    x_prev = np.empty_like(x)
    w = parts.inverse_masses
    backward = number % 2 == 1
    constraints.predict(x, x_prev, v, w, world.gravity, float(np.exp(-world.drag * h)), h)
    constraints.project_distances(
        x, x_prev, w, parts.edges, parts.rest, parts.edge_compliance, parts.edge_damping, h, backward
    )
    constraints.project_volumes(
        x, x_prev, w, parts.tets, parts.volumes, parts.tet_compliance, parts.tet_damping, h, backward
    )
    if len(parts.cluster_rates):
        constraints.match_shapes(
            x,
            w,
            parts.masses,
            parts.rest,
            parts.cluster_members,
            parts.cluster_starts,
            parts.cluster_rates,
            h,
        )
    if world.collide:
        pairs = contacts.find_pairs(x, parts.rest, parts.surface, parts.body, parts.radii, parts.reach)
        if len(pairs):
            contacts.collide_pairs(x, x_prev, w, pairs, parts.radii)
    now = (number + 1) * h
    if world.spheres:
        flows = np.array([s.velocity for s in world.spheres])
        centers = np.array([s.center for s in world.spheres]) + now * flows
        radii = np.array([s.radius for s in world.spheres], dtype=np.float64)
        frictions = np.array([s.friction for s in world.spheres], dtype=np.float64)
        contacts.collide_spheres(x, x_prev, w, centers, radii, h * flows, frictions)
    if world.planes:
        flows = np.array([p.velocity for p in world.planes])
        points = np.array([p.point for p in world.planes]) + now * flows
        normals = np.array([p.normal for p in world.planes])
        frictions = np.array([p.friction for p in world.planes], dtype=np.float64)
        contacts.collide_planes(x, x_prev, w, normals, points, h * flows, frictions)
    constraints.update_velocities(x, x_prev, v, w, h)
