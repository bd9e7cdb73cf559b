"""The laws: fall, momentum, energy, contacts, pins, recovery, stability, the same bytes every time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.physics.body import Body, Material, deformation_gradients, make_body, pose, strain_norms
from engine.lab.sim.physics.world import Plane, Sphere, World, energy, step
from engine.model import GaussianModel
from tests.lab.sim.physics.conftest import NOWHERE, UNDAMPED, angular_momentum, center, ground, momentum, run
from tests.threads import with_one_and_two_threads


def excited(body: Body) -> Body:
    """Stretched by 20 %, spinning and flying."""
    middle = center(body)
    stretched = middle + (body.positions - middle) * [1.2, 0.9, 1.0]
    return replace(
        body, positions=stretched, velocities=np.cross([0.0, 2.0, 1.0], stretched - middle) + np.array([0.3, 0.1, 0.0])
    )


def volumes(body: Body) -> np.ndarray:
    """Volumes of the tetrahedra in rest volumes; negative where inverted."""
    return np.linalg.det(deformation_gradients(body))


def test_free_fall_is_that_of_the_closed_form(body: Body) -> None:
    world = World((replace(body, velocities=body.velocities + np.array([1.0, 2.0, 0.0])),))
    fallen = run(world, 60)
    t, h = fallen.time, 1.0 / 60.0 / world.substeps
    assert t == pytest.approx(1.0)
    np.testing.assert_allclose(
        fallen.bodies[0].velocities, np.tile([1.0, 2.0 - 9.81 * t, 0.0], (len(body.masses), 1)), atol=1e-9
    )
    travelled = fallen.bodies[0].positions - body.positions
    # Steps of h with the velocity at their end: lower than the parabola by g t h / 2, 4 mm after 1 s.
    expected = np.array([t, 2.0 * t - 0.5 * 9.81 * t * (t + h), 0.0])
    np.testing.assert_allclose(travelled, np.broadcast_to(expected, travelled.shape), atol=1e-9)
    np.testing.assert_allclose(pose(fallen.bodies[0]).means, body.model.means + expected, atol=1e-5)
    assert strain_norms(fallen.bodies[0]).max() < 1e-9


MATERIALS = {"soft": UNDAMPED, "damped": Material(), "stiff volume": Material(volume_compliance=1e-6, viscosity=0.0)}


@pytest.mark.parametrize("name", MATERIALS)
def test_momentum_stays_and_energy_never_grows_without_external_forces(name: str, body: Body) -> None:
    """Both momenta to 1e-8 of themselves, energy to 1e-6 of the first; the rest of it is spin and flight."""
    world = World((excited(replace(body, material=MATERIALS[name])),), gravity=NOWHERE, collide=False)
    linear, angular, energies = momentum(world), angular_momentum(world), [energy(world)]
    for _ in range(60):
        world = step(world)
        energies.append(energy(world))
    np.testing.assert_allclose(momentum(world), linear, atol=1e-8 * np.linalg.norm(linear))
    np.testing.assert_allclose(angular_momentum(world), angular, atol=1e-8 * np.linalg.norm(angular))
    totals = np.array([e.total for e in energies])
    assert np.diff(totals).max() <= 1e-6 * totals[0]
    assert energies[0].elastic > 10 * energies[0].kinetic
    assert energies[-1].elastic < 0.1 * energies[0].elastic
    assert energies[-1].kinetic > 0.5 * energies[0].kinetic  # it still flies and spins


def test_damping_takes_energy_from_strain_and_drag_from_motion(body: Body) -> None:
    def after(material: Material, drag: float, steps: int) -> World:
        return run(World((excited(replace(body, material=material)),), gravity=NOWHERE, drag=drag), steps)

    free, damped = after(UNDAMPED, 0.0, 8), after(Material(viscosity=500.0), 0.0, 8)
    assert energy(damped).total < 0.5 * energy(free).total
    slowed, free = after(UNDAMPED, 2.0, 60), after(UNDAMPED, 0.0, 60)
    np.testing.assert_allclose(
        momentum(slowed), np.exp(-2.0) * momentum(free), atol=1e-6 * np.linalg.norm(momentum(free))
    )
    assert energy(slowed).total < 0.1 * energy(free).total


def test_stiffness_does_not_hang_on_the_resolution(ball: GaussianModel) -> None:
    """Under the same squeeze coarse and fine bodies store the same energy density, within a fifth."""
    density = []
    for resolution in (4, 8):
        body = make_body(ball, resolution=resolution)
        squeezed = replace(body, positions=body.positions * [1.0, 0.95, 1.0])
        world = World((squeezed,), gravity=NOWHERE)
        density.append(energy(world).elastic / body.masses.sum())
    assert density[0] == pytest.approx(density[1], rel=0.2)


@pytest.mark.parametrize("kind", ["one corner through its face", "mirrored", "flattened", "one point", "shuffled"])
def test_inverted_and_degenerate_elements_recover(kind: str, ball: GaussianModel) -> None:
    body = make_body(ball, resolution=4, material=Material(viscosity=500.0))
    x = body.positions.copy()
    rng = np.random.default_rng(0)
    if kind == "one corner through its face":
        tet = body.lattice.tets[10]
        x[tet[0]] += 2.2 * (x[tet[1:]].mean(axis=0) - x[tet[0]])
    elif kind == "mirrored":
        x[:, 0] = 2 * x[:, 0].mean() - x[:, 0]
    elif kind == "flattened":
        x[:, 1] = x[:, 1].mean()
    elif kind == "one point":
        x[:] = x.mean(axis=0)
    else:
        x = x[rng.permutation(len(x))]
    broken = replace(body, positions=x)
    assert volumes(broken).min() < 1e-9
    assert all(np.isfinite(getattr(pose(broken), n)).all() for n in ("means", "log_scales", "quats", "sh"))
    world = run(World((broken,), gravity=NOWHERE, collide=False), 150)
    after = world.bodies[0]
    assert np.isfinite(after.positions).all()
    assert np.isfinite(pose(after).log_scales).all()
    if kind in ("mirrored", "shuffled"):  # a mirror image is at peace but for its volumes: most of it turns over
        assert (volumes(after) > 0).mean() > 0.9
    else:
        assert volumes(after).min() > 0.1
        assert np.median(strain_norms(after)) < 0.01


def test_pinned_gaussians_stay_and_the_rest_hangs_from_them(ball: GaussianModel) -> None:
    top = ball.means[:, 1] > 0.95
    soft = Material(compliance=5e-4, volume_compliance=1e-4, viscosity=500.0)
    body = make_body(ball, resolution=5, material=soft, pinned=top, velocity=(1.0, 0.0, 0.0))
    world = run(World((body,)), 90)
    after = pose(world.bodies[0])
    np.testing.assert_allclose(after.means[top], ball.means[top], atol=1e-6)
    np.testing.assert_allclose(after.log_scales[top], ball.log_scales[top], atol=1e-6)
    low = ball.means[:, 1] < 0.3
    assert (after.means[low, 1] < ball.means[low, 1] - 0.01).all()
    wall = World((body,), planes=(ground(2.0),), spheres=(Sphere(ball.means.mean(axis=0), 3.0),))
    np.testing.assert_array_equal(step(wall).bodies[0].positions[body.pinned], body.positions[body.pinned])
    all_pinned = make_body(ball, resolution=4, pinned=np.ones(len(ball), dtype=bool))
    still = run(World((all_pinned,)), 3).bodies[0]
    held = np.unique(all_pinned.lattice.tets[all_pinned.binding.tet])
    np.testing.assert_array_equal(still.positions[held], all_pinned.positions[held])


def test_same_bytes_whatever_the_thread_count(body: Body) -> None:
    world = World((excited(body),), planes=(ground(-0.2),))

    def answer() -> tuple[np.ndarray, ...]:
        after = run(world, 25).bodies[0]
        return after.positions, after.velocities, pose(after).quats, pose(after).sh

    for one, other in zip(*with_one_and_two_threads(answer), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_step_leaves_its_world_as_it_was(body: Body) -> None:
    world = World((excited(body),), planes=(ground(0.1),))
    before = world.bodies[0].positions.copy(), world.bodies[0].velocities.copy()
    after = step(world)
    np.testing.assert_array_equal(world.bodies[0].positions, before[0])
    np.testing.assert_array_equal(world.bodies[0].velocities, before[1])
    assert np.abs(after.bodies[0].positions - before[0]).max() > 1e-3
    assert world.time == 0.0


def test_a_real_plant_dropped_and_squashed_is_stable_for_1000_steps(plant: GaussianModel) -> None:
    """At the default step and material: dropped from 0.2 of its height, then pressed to half by a lid."""
    body = make_body(plant, resolution=8)
    up = np.array([0.0, -1.0, 0.0])  # this capture stands on its head
    start = float((body.positions @ up).min()) - 0.2
    world = World((body,), gravity=-9.81 * up, planes=(ground(start, up),))
    highest, began = -np.inf, energy(world).total
    for number in range(1000):
        if number == 300:
            top = (world.bodies[0].positions @ up).max()
            world = replace(world, planes=(*world.planes, Plane(top * up, -up, velocity=-0.3 * up)))
        if number == 360:
            assert strain_norms(world.bodies[0]).max() > 0.2
            world = replace(world, planes=world.planes[:1])
        world = step(world)
        if number < 300:
            highest = max(highest, energy(world).total)
        assert np.abs(world.bodies[0].velocities).max() < 20.0
    after = world.bodies[0]
    assert highest <= began + 0.01 * body.masses.sum() * 9.81 * 0.2  # 1 % of the fall
    assert (after.positions @ up).min() >= start - 1e-9
    assert energy(world).kinetic < 1e-3 * body.masses.sum() * 9.81  # a millimetre's fall
    assert volumes(after).min() > 0.2
    assert strain_norms(after).max() < 0.5


def test_unfit_worlds_are_refused(body: Body) -> None:
    for call, message in (
        (lambda: World(()), "at least one body"),
        (lambda: World((body,), gravity=(0.0, np.nan, 0.0)), "gravity"),
        (lambda: World((body,), drag=-1.0), "drag"),
        (lambda: World((body,), substeps=0), "substep"),
        (lambda: Plane((0, 0, 0), (0, 0, 0)), "normal"),
        (lambda: Plane((0, 0, 0), (0, 1, 0), friction=-1.0), "friction"),
        (lambda: Sphere((0, 0, 0), 0.0), "radius"),
        (lambda: Sphere((0, 0), 1.0), "center"),
        (lambda: step(World((body,)), 0.0), "positive time"),
        (lambda: step(World((body,)), float("nan")), "positive time"),
    ):
        with pytest.raises(InputError, match=message):
            call()
