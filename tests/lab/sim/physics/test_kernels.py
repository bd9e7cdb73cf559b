"""Every kernel of a substep against its slow twin, compiled and as plain Python."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from engine.lab.sim.physics import xpbd_kernels as contacts
from engine.lab.sim.physics import xpbd_kernels as fast
from engine.lab.sim.physics.body import Assembly, Material, assemble, make_body
from engine.model import GaussianModel
from tests.reference import physics as slow

H = 1.0 / 600.0


@pytest.fixture(scope="module")
def parts(ball: GaussianModel) -> Assembly:
    """A strained body with pins, of finite compliances."""
    material = Material(1e-4, 2e-5, viscosity=40.0)
    pinned = ball.means[:, 1] > 0.95
    return assemble([make_body(ball, resolution=4, material=material, pinned=pinned)])


@pytest.fixture
def state(parts: Assembly) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    x_prev = parts.rest + 0.02 * rng.standard_normal(parts.rest.shape)
    return x_prev + 0.01 * rng.standard_normal(parts.rest.shape), x_prev


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("backward", [True, False])
@pytest.mark.parametrize("kind", ["distances", "volumes", "dashpots"])
def test_constraints(
    kind: str, backward: bool, compiled: bool, parts: Assembly, state: tuple[np.ndarray, np.ndarray]
) -> None:
    x, x_prev = state
    w = parts.inverse_masses
    if kind == "distances":
        x[parts.edges[3, 0]] = x[parts.edges[3, 1]]  # a collapsed edge
        arguments = (w, parts.edges, parts.rest, parts.edge_compliance, H, backward)
        function, twin = fast.project_distances, slow.distances
    elif kind == "volumes":
        arguments = (w, parts.tets, parts.volumes, parts.tet_compliance, H, backward)
        function, twin = fast.project_volumes, slow.volumes
    else:  # what moves are velocities
        still = x.copy()
        x = 10.0 * (x - x_prev)
        arguments = (w, parts.edges, parts.edge_damping, H, backward)
        function = SimpleNamespace(py_func=lambda v, *a: fast.damp_velocities.py_func(still, v, *a))
        if compiled:
            function = lambda v, *a: fast.damp_velocities(still, v, *a)  # noqa: E731
        twin = lambda v, *a: slow.dashpots(still, v, *a)  # noqa: E731
    one, other = x.copy(), x.copy()
    (function if compiled else function.py_func)(one, *arguments)
    twin(other, *arguments)
    np.testing.assert_allclose(one, other, atol=1e-12)
    assert np.abs(one - x).max() > 1e-3
    assert (one == x)[parts.inverse_masses == 0].all()


@pytest.mark.parametrize("compiled", [True, False])
def test_pairs_are_all_found_once(compiled: bool) -> None:
    rng = np.random.default_rng(1)
    count = 240
    x, rest = rng.uniform(-0.5, 0.5, (count, 3)), rng.uniform(-1.0, 1.0, (count, 3))
    rest[:60] = x[:60]  # these are near each other at rest already
    surface = np.sort(rng.permutation(count)[:200])
    body = np.repeat(np.arange(2, dtype=np.int32), count // 2)
    radii = np.where(body == 0, 0.08, 0.05)
    find = contacts.find_pairs if compiled else contacts.find_pairs.py_func
    found = find(x, rest, surface, body, radii, 0.16)
    assert {tuple(p) for p in found.tolist()} == slow.pairs(x, rest, surface, body, radii)
    assert len(found) == len({tuple(p) for p in found.tolist()}) > 100
    everything = find(np.zeros((40, 3)), 9.0 * rest[:40], np.arange(40), body[:40], radii[:40], 0.16)
    assert len(everything) > 600  # more than there was room for at first


@pytest.mark.parametrize("compiled", [True, False])
def test_pairs_come_apart_and_keep_their_momentum(compiled: bool) -> None:
    rng = np.random.default_rng(2)
    x_prev = 0.17 * np.argwhere(np.ones((3, 3, 3))) + 0.002 * rng.standard_normal((27, 3))  # clear of each other
    x = 0.7 * x_prev + 0.01 * rng.standard_normal((27, 3))  # and rushing together
    masses = rng.uniform(1.0, 3.0, 27)
    radii = np.full(27, 0.08)
    surface, body = np.arange(27), np.arange(27, dtype=np.int32)
    pairs = contacts.find_pairs(x, x, surface, body, radii, 0.16)
    assert len(pairs) > 20
    one, past = x.copy(), x_prev.copy()
    (contacts.collide_pairs if compiled else contacts.collide_pairs.py_func)(one, past, 1 / masses, pairs, radii)
    gap = np.linalg.norm(one[pairs[:, 0]] - one[pairs[:, 1]], axis=1)
    was = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    assert gap.mean() > was.mean() + 0.003
    np.testing.assert_array_equal(past, x_prev)
    np.testing.assert_allclose(masses @ one, masses @ x, atol=1e-13)  # linear
    angular = [masses @ np.cross(x_prev, after) for after in (x, one)]  # of velocities (x - x_prev) / h
    np.testing.assert_allclose(angular[1], angular[0], atol=1e-13)


def test_old_overlaps_are_resolved_without_speed() -> None:
    x = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    v, w, radii = np.zeros_like(x), np.ones(4), np.full(4, 0.05)
    for _ in range(60):
        x_prev = np.empty_like(x)
        fast.predict(x, x_prev, v, w, np.zeros(3), 1.0, H)
        pairs = contacts.find_pairs(x, x, np.arange(4), np.arange(4, dtype=np.int32), radii, 0.1)
        contacts.collide_pairs(x, x_prev, w, pairs, radii)
        fast.update_velocities(x, x_prev, v, w, H)
    assert x[1, 0] - x[0, 0] == pytest.approx(0.1, abs=1e-3)
    assert np.linalg.norm(x[3] - x[2]) == pytest.approx(0.1, abs=1e-3)  # coincident points too
    assert np.abs(v).max() < 1e-9


@pytest.mark.parametrize("compiled", [True, False])
def test_planes_and_spheres_stop_what_comes_and_carry_what_lies(compiled: bool) -> None:
    plane = contacts.collide_plane if compiled else contacts.collide_plane.py_func
    sphere = contacts.collide_sphere if compiled else contacts.collide_sphere.py_func
    up, origin = np.array([0.0, 1.0, 0.0]), np.zeros(3)
    x_prev = np.array([[0.0, 0.1, 0.0], [1.0, 0.1, 0.0], [2.0, -0.3, 0.0], [3.0, 0.1, 0.0]])
    x = x_prev + np.array([[0.0, -0.2, 0.0], [0.5, -0.2, 0.0], [0.0, 0.0, 0.0], [0.0, -0.2, 0.0]])
    w = np.array([1.0, 1.0, 1.0, 0.0])
    start = x.copy()
    plane(x, x_prev, w, origin, up, np.zeros(3), 0.5)
    np.testing.assert_allclose(x[0], [0, 0, 0], atol=1e-15)
    np.testing.assert_allclose(x[1], [1.45, 0, 0])  # 0.1 deep, so friction takes 0.05 of its way
    np.testing.assert_allclose([x[2, 1], x_prev[2, 1]], 0.0, atol=1e-15)  # it was inside: out, at rest
    np.testing.assert_array_equal(x[3], start[3])  # pinned
    # On a belt that moves by 0.02, strong friction carries a point along.
    x, x_prev = np.array([[0.0, -0.1, 0.0]]), np.array([[0.0, 0.0, 0.0]])
    plane(x, x_prev, np.ones(1), origin, up, np.array([0.02, 0.0, 0.0]), 1.0)
    np.testing.assert_allclose(x, [[0.02, 0.0, 0.0]], atol=1e-15)
    # A ball that has moved by 0.1 towards a point pushes it out along the line from its center.
    x = np.array([[0.0, 0.0, 0.45], [0.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    x_prev = x + np.array([[0.0, 0.0, 0.05], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    sphere(x, x_prev, np.ones(3), origin, 0.5, np.zeros(3), 0.0)
    np.testing.assert_allclose(x, [[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 2.0]])
    np.testing.assert_allclose(x_prev, [[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 2.0]])
