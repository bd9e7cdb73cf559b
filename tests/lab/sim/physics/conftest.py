"""A small solid ball of Gaussians with directional color, and the real plant."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from engine.lab.sim.physics.body import Body, Material, assemble, make_body
from engine.lab.sim.physics.world import Plane, World, step
from engine.model import Float64, GaussianModel

NOWHERE = np.zeros(3)
UNDAMPED = Material(viscosity=0.0)


@pytest.fixture(scope="session")
def ball() -> GaussianModel:
    """600 overlapping Gaussians filling a ball of radius 0.5 about (0.2, 0.6, -0.1), SH degree 3."""
    rng = np.random.default_rng(3)
    n = 600
    directions = rng.standard_normal((n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    means = np.array([0.2, 0.6, -0.1]) + 0.5 * np.cbrt(rng.random((n, 1))) * directions
    quats = rng.standard_normal((n, 4))
    sh = 0.12 * rng.standard_normal((n, 16, 3))
    sh[:, 0] = 0.8 * np.sin(4 * means + [0, 1, 2])
    return GaussianModel(
        means.astype(np.float32),
        np.log(rng.uniform(0.01, 0.08, (n, 3))).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.normal(2.0, 1.0, n).astype(np.float32),
        sh.astype(np.float32),
    )


@pytest.fixture(scope="module")
def body(ball: GaussianModel) -> Body:
    return make_body(ball, resolution=5, material=UNDAMPED)


def run(world: World, steps: int) -> World:
    for _ in range(steps):
        world = step(world)
    return world


def center(body: Body) -> Float64:
    return np.asarray(body.masses @ body.positions / body.masses.sum())


def momentum(world: World) -> Float64:
    """(3,) linear momentum of all bodies, kg scene units per second."""
    parts = assemble(world.bodies)
    return np.asarray(parts.masses @ parts.velocities)


def angular_momentum(world: World) -> Float64:
    """(3,) angular momentum of all bodies about the origin."""
    parts = assemble(world.bodies)
    return np.asarray(parts.masses @ np.cross(parts.positions, parts.velocities))


def ground(height: float, up: npt.ArrayLike = (0.0, 1.0, 0.0), friction: float = 0.5) -> Plane:
    """Level ground at a height along `up`, a unit vector."""
    return Plane(height * np.array(up), np.array(up), friction=friction)
