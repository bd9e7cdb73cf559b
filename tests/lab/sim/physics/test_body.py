"""Lattices, bindings and poses: the model sits in its tetrahedra and follows every motion of theirs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.physics.body import (
    Body,
    Material,
    build_lattice,
    color_by_strain,
    deformation_gradients,
    kernel_means,
    kernel_strains,
    kernel_velocities,
    make_body,
    pose,
    strain_norms,
)
from engine.lab.sim.physics.deforming import interpolate
from engine.model import SH_C0, GaussianModel, look_at
from engine.numerics.image_metrics import psnr
from engine.numerics.similarity import quaternion_to_rotation, transform_model
from engine.raster import render
from tests.reference.deformation import deformed_covariance
from tests.reference.physics import barycentric
from tests.reference.similarity import covariance


@pytest.fixture(scope="module")
def body(ball: GaussianModel) -> Body:
    return make_body(ball, resolution=6)


def moved(body: Body, linear: np.ndarray, shift: np.ndarray | float = 0.0) -> Body:
    return replace(body, positions=body.lattice.points @ linear.T + shift)


def test_lattice_is_a_conforming_mesh_of_positive_volumes(body: Body) -> None:
    lattice = body.lattice
    corners = lattice.points[lattice.tets]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    np.testing.assert_allclose(volumes, lattice.tet_volume)
    faces = np.sort(np.concatenate([np.delete(lattice.tets, k, axis=1) for k in range(4)]), axis=1)
    _, shared = np.unique(faces, axis=0, return_counts=True)
    assert set(shared) == {1, 2}  # every face is on the outside or between two
    on_outside = np.zeros(len(lattice.points), dtype=bool)
    outer = np.unique(faces, axis=0)[shared == 1]
    on_outside[np.unique(outer)] = True
    np.testing.assert_array_equal(on_outside, lattice.surface)
    assert 0 < on_outside.sum() < len(on_outside)
    edges = {tuple(sorted((a, b))) for tet in lattice.tets.tolist() for a in tet for b in tet if a != b}
    assert edges == set(map(tuple, lattice.edges.tolist()))


def test_bindings_match_the_twin(body: Body, ball: GaussianModel) -> None:
    lattice, binding = body.lattice, body.binding
    for n in range(0, len(ball), 17):
        corners = lattice.points[lattice.tets[binding.tet[n]]]
        np.testing.assert_allclose(binding.weights[n], barycentric(ball.means[n], corners), atol=1e-6)
    visible = ball.opacities >= 0.1 * ball.opacities.max()
    assert binding.weights[visible].min() > -1e-9
    np.testing.assert_allclose(kernel_means(body), ball.means, atol=1e-6)


def test_compiled_interpolation_equals_its_formula(body: Body) -> None:
    arguments = (body.positions, body.lattice.tets, body.binding.tet[:20], body.binding.weights[:20])
    one, other = np.empty((20, 3)), np.empty((20, 3))
    interpolate(*arguments, one)
    interpolate.py_func(*arguments, other)
    np.testing.assert_allclose(one, other, rtol=1e-14)


def test_hollow_bodies_are_filled_and_floaters_left_out(ball: GaussianModel) -> None:
    rng = np.random.default_rng(0)
    shell = rng.standard_normal((6000, 3))
    shell *= 0.5 / np.linalg.norm(shell, axis=1, keepdims=True)
    n = len(shell) + 1
    model = GaussianModel(
        np.vstack([shell, [[0.75, 0.0, 0.0]]]),
        np.full((n, 3), -5.0, dtype=np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        np.full(n, 3.0, dtype=np.float32),
        np.zeros((n, 1, 3), dtype=np.float32),
    )
    lattice, binding = build_lattice(model, 12)
    assert len(lattice.tets) * lattice.tet_volume > 4 / 3 * np.pi * 0.5**3
    assert lattice.points[:, 0].max() < 0.65
    assert binding.weights[-1].min() < -0.5  # the floater rides along outside
    assert binding.weights[-1].sum() == pytest.approx(1.0)


def test_resolution_refines_the_lattice_and_mass_follows_volume(ball: GaussianModel) -> None:
    coarse, fine = (make_body(ball, resolution=r, density=100.0) for r in (4, 10))
    assert len(fine.lattice.tets) > 4 * len(coarse.lattice.tets)
    for body in (coarse, fine):
        assert body.masses.sum() == pytest.approx(100.0 * len(body.lattice.tets) * body.lattice.tet_volume)
        assert body.masses.min() > 0


@pytest.mark.parametrize("count", [1, 2])
def test_smallest_models_are_bodies_too(count: int, ball: GaussianModel) -> None:
    body = make_body(ball.take(np.arange(count)), resolution=2)
    assert len(body.lattice.tets) >= 6
    np.testing.assert_allclose(pose(body).means, ball.means[:count], atol=1e-6)


def test_gradient_of_an_affine_map_is_exact(body: Body) -> None:
    A = np.array([[1.2, 0.3, -0.1], [0.0, 0.7, 0.4], [0.2, -0.5, 1.1]])
    after = moved(body, A, np.array([1.0, -2.0, 3.0]))
    np.testing.assert_allclose(
        deformation_gradients(after), np.broadcast_to(A, (len(body.lattice.tets), 3, 3)), atol=1e-11
    )
    posed = pose(after)
    np.testing.assert_allclose(posed.means, body.model.means @ A.T + [1, -2, 3], atol=2e-6)
    for i in range(0, len(posed), 40):
        expected = deformed_covariance(body.model, i, A)
        np.testing.assert_allclose(covariance(posed, i), expected, atol=1e-5 * np.abs(expected).max())
    green = 0.5 * (A.T @ A - np.eye(3))
    np.testing.assert_allclose(kernel_strains(after)[5], green, atol=1e-11)
    np.testing.assert_allclose(strain_norms(after), np.linalg.norm(green))


def test_a_rigidly_moved_body_renders_as_the_moved_model(body: Body, ball: GaussianModel) -> None:
    R, t = quaternion_to_rotation(np.array([0.5, -0.1, 0.7, 0.5]) / np.sqrt(1.0)), np.array([0.4, 0.1, -0.3])
    expected = transform_model(ball, 1.0, R, t)
    after = moved(body, R, t)
    posed = pose(after)
    center = expected.means.mean(axis=0)
    camera = look_at(center + np.array([1.0, 0.4, 1.5]), center, (0, -1, 0), 120.0, 96, 80)
    picture = render(expected, camera)
    assert psnr(picture, render(posed, camera)) > 80
    assert psnr(picture, render(posed.with_(sh=ball.sh), camera)) < 40
    assert strain_norms(after).max() < 1e-9


def test_gaussians_carry_velocity_and_strain_colors(body: Body) -> None:
    spin = np.array([[0.0, -2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    turning = replace(body, velocities=body.positions @ spin.T)
    np.testing.assert_allclose(kernel_velocities(turning), body.model.means @ spin.T, atol=1e-6)
    calm, strained = color_by_strain(body), color_by_strain(moved(body, np.diag([1.5, 1.0, 1.0])))
    assert calm.sh.shape[1] == 1
    np.testing.assert_allclose(0.5 + SH_C0 * calm.sh[:, 0], np.tile([0.267, 0.005, 0.329], (len(calm), 1)), atol=1e-3)
    assert (strained.sh[:, 0, 1] > calm.sh[:, 0, 1] + 1).all()  # towards yellow
    np.testing.assert_allclose(strained.means[:, 0], 1.5 * body.model.means[:, 0], atol=1e-5)


def test_unfit_bodies_are_refused(ball: GaussianModel) -> None:
    for call, message in (
        (lambda: make_body(ball.take(np.arange(0))), "empty"),
        (lambda: make_body(ball, resolution=1), "got 1"),
        (lambda: make_body(ball, resolution=1000), "1000"),
        (lambda: make_body(ball, density=0.0), "density"),
        (lambda: make_body(ball, velocity=(1.0, 2.0)), "velocity"),
        (lambda: make_body(ball, pinned=np.zeros(3, dtype=bool)), "600 booleans"),
        (lambda: Material(compliance=-1.0), "compliance"),
        (lambda: Material(viscosity=float("nan")), "viscosity"),
        (lambda: color_by_strain(make_body(ball, resolution=2), 0.0), "strain"),
    ):
        with pytest.raises(InputError, match=message):
            call()
