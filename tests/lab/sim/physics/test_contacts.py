"""Contacts of whole bodies: with the ground, slopes, lids, balls, each other and themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.lab.sim.physics.body import Body, Material, make_body, strain_norms
from engine.lab.sim.physics.world import Plane, Sphere, World, energy, step
from engine.model import GaussianModel
from tests.lab.sim.physics.conftest import NOWHERE, UNDAMPED, angular_momentum, center, ground, momentum, run


def test_a_body_comes_to_rest_on_the_ground(body: Body) -> None:
    lying = replace(body, material=Material(viscosity=500.0), velocities=body.velocities + np.array([0.0, -1.0, 0.0]))
    world = World((lying,), planes=(ground(-0.1),), drag=0.5)
    lowest, totals = [], []
    for _ in range(120):
        world = step(world)
        lowest.append(world.bodies[0].positions[:, 1].min())
        totals.append(energy(world).total)
    assert min(lowest) >= -0.1 - 1e-9
    assert lowest[-1] == pytest.approx(-0.1, abs=1e-6)
    assert energy(world).kinetic < 0.1 * body.masses.sum() * 9.81 * 0.2  # a slow roll
    # One pass per substep: in a step energy may grow by 1 % of what the fall had, and over all it sinks.
    assert np.diff(totals).max() <= 0.01 * body.masses.sum() * 9.81 * 0.2
    assert max(totals) <= totals[0] * (1 + 1e-6)
    assert totals[-1] < totals[0] - 0.1 * body.masses.sum() * 9.81 * 0.2


def slab(ball: GaussianModel, half: tuple[float, float, float]) -> GaussianModel:
    """A solid box of 3,000 small Gaussians about the origin."""
    rng = np.random.default_rng(1)
    few = ball.take(rng.integers(len(ball), size=3000))
    return few.with_(
        means=rng.uniform(-1.0, 1.0, (3000, 3)) * half,
        log_scales=np.full((3000, 3), -5.0),
        opacity_logits=np.full(3000, 3.0),
    )


@pytest.mark.parametrize("friction", [0.0, 0.3, 0.9])
def test_a_slab_slides_down_a_slope_as_coulomb_says(friction: float, ball: GaussianModel) -> None:
    body = make_body(
        slab(ball, (0.5, 0.15, 0.5)), resolution=6, material=Material(compliance=1e-7, volume_compliance=1e-7)
    )
    slope = np.radians(30.0)  # gravity is tilted, not the ground
    gravity = 9.81 * np.array([np.sin(slope), -np.cos(slope), 0.0])
    low = body.positions[:, 1].min()
    world = run(World((body,), gravity=gravity, planes=(ground(low, friction=friction),)), 30)
    way = (center(world.bodies[0]) - center(body))[0]
    pull = max(np.sin(slope) - friction * np.cos(slope), 0.0)
    assert way == pytest.approx(0.5 * 9.81 * pull * world.time**2, rel=0.05, abs=0.01)


def test_a_lid_squashes_and_a_ball_dents(body: Body) -> None:
    top, low = body.positions[:, 1].max(), body.positions[:, 1].min()
    lid = Plane((0.0, top, 0.0), (0.0, -1.0, 0.0), velocity=(0.0, -0.5, 0.0))
    world = run(World((body,), gravity=NOWHERE, planes=(ground(low), lid)), 30)
    squashed = world.bodies[0].positions
    np.testing.assert_allclose(world.planes[1].point[1], top - 0.25)
    assert squashed[:, 1].max() <= top - 0.25 + 1e-9
    assert squashed[:, 1].min() >= low - 1e-9
    assert np.ptp(squashed[:, 0]) > 1.03 * np.ptp(body.positions[:, 0])  # it bulges
    assert strain_norms(world.bodies[0]).mean() > 0.05
    pusher = Sphere(center(body) + np.array([-1.2, 0.0, 0.0]), 0.5, velocity=(1.0, 0.0, 0.0))
    world = run(World((body,), gravity=NOWHERE, spheres=(pusher,)), 40)
    away = np.linalg.norm(world.bodies[0].positions - world.spheres[0].center, axis=1)
    assert away.min() >= 0.5 - 1e-9
    assert center(world.bodies[0])[0] > center(body)[0] + 0.05


def test_bodies_collide_and_share_their_momentum(body: Body, ball: GaussianModel) -> None:
    other = make_body(ball, resolution=7, material=UNDAMPED, velocity=(-2.0, 0.0, 0.0))
    other = replace(other, positions=other.positions + np.array([1.5, 0.05, 0.0]))
    hit = replace(body, velocities=body.velocities + np.array([2.0, 0.0, 0.0]))
    start = World((hit, other), gravity=NOWHERE)
    before = momentum(start), angular_momentum(start), energy(start).total
    world = run(start, 40)
    first, second = world.bodies
    assert first.positions[:, 0].max() < second.positions[:, 0].max()
    gap = center(second)[0] - center(first)[0]
    assert gap > 0.7  # without contact they would have passed through each other
    np.testing.assert_allclose(momentum(world), before[0], atol=1e-8 * 2 * body.masses.sum())
    relative = momentum(World((second,)))[0] / second.masses.sum() - momentum(World((first,)))[0] / first.masses.sum()
    assert relative > -0.4  # they came at each other with 4
    np.testing.assert_allclose(angular_momentum(world), before[1], atol=0.02 * np.linalg.norm(before[1]))
    assert energy(world).total < before[2]
    through = run(replace(start, collide=False), 40)
    assert center(through.bodies[0])[0] > center(through.bodies[1])[0]


def test_a_body_does_not_pass_through_itself(ball: GaussianModel) -> None:
    """A bar whose one end is thrown at its other half: with collisions the end is held up by it."""
    bar = slab(ball, (1.0, 0.1, 0.1))
    body = make_body(bar, resolution=20, material=Material(compliance=1e-3, volume_compliance=1e-3))
    far = body.positions[:, 0] > 0.6
    folded = body.positions.copy()
    folded[far] += [-1.45, 0.35, 0.0]  # one end laid over the other half
    falling = replace(body, positions=folded, velocities=np.where(far[:, None], [0.0, -4.0, 0.0], 0.0))
    limits = []
    for collide in (True, False):
        world = run(replace(World((falling,), gravity=NOWHERE), collide=collide), 6)
        upper = world.bodies[0].positions[far]
        lower = world.bodies[0].positions[~far & body.lattice.surface]
        limits.append(np.linalg.norm(upper[:, None] - lower[None], axis=2).min(axis=1))
    # Points keep 0.9 cells apart, less what one pass leaves of a crowd.
    assert np.quantile(limits[0], 0.1) > 0.6 * body.lattice.cell > 0.3 * body.lattice.cell > np.quantile(limits[1], 0.1)
