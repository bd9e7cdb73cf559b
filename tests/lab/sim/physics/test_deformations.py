"""Bend, twist, squash: gradients against finite differences, volumes, angles, ends."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.attacks import model_attack
from engine.lab.sim.physics.deformations import (
    barrel_points,
    bend,
    bend_points,
    longest_axis,
    squash,
    twist,
    twist_points,
)
from engine.model import Float64, GaussianModel
from tests.reference.deformation import deformed_covariance
from tests.reference.similarity import covariance

PointMap = Callable[[Float64, float, float], tuple[Float64, Float64]]
MAPS = [(bend_points, 1.3), (bend_points, -0.4), (twist_points, 2.0), (barrel_points, 0.6), (barrel_points, 2.2)]


@pytest.fixture(scope="module")
def rod() -> GaussianModel:
    """2,000 small Gaussians in a rod of length 2 and width 0.4 along y, the first 101 of them on its axis."""
    rng = np.random.default_rng(2)
    means = rng.uniform([-0.2, -1.0, -0.2], [0.2, 1.0, 0.2], (2000, 3)) + np.array([1.0, 2.0, 3.0])
    means[:101] = np.linspace([1.0, 1.0, 3.0], [1.0, 3.0, 3.0], 101)
    quats = rng.standard_normal((2000, 4))
    return GaussianModel(
        means.astype(np.float32),
        np.log(rng.uniform(0.01, 0.03, (2000, 3))).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        np.full(2000, 2.0, dtype=np.float32),
        rng.standard_normal((2000, 1, 3)).astype(np.float32),
    )


@pytest.mark.parametrize(("points_map", "strength"), MAPS)
def test_gradients_are_the_derivatives_of_the_map(points_map: PointMap, strength: float) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([-1.6, -0.5, -0.5], [1.6, 0.5, 0.5], (300, 3))  # beyond the ends too
    points = points[np.abs(np.abs(points[:, 0]) - 1.0) > 1e-3]
    _, gradients = points_map(points, 2.0, strength)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-6
        there, back = (points_map(points + sign * step, 2.0, strength)[0] for sign in (1, -1))
        np.testing.assert_allclose(gradients[:, :, axis], (there - back) / 2e-6, atol=1e-7)
    beyond = np.abs(points[:, 0]) > 1
    rigid = gradients[beyond] @ gradients[beyond].transpose(0, 2, 1)
    np.testing.assert_allclose(rigid, np.broadcast_to(np.eye(3), rigid.shape), atol=1e-9)
    assert np.abs(gradients[~beyond] - np.eye(3)).max() > 0.1


@pytest.mark.parametrize(("points_map", "none"), [(bend_points, 0.0), (twist_points, 0.0), (barrel_points, 1.0)])
def test_no_strength_is_no_deformation(points_map: PointMap, none: float) -> None:
    points = np.random.default_rng(1).standard_normal((50, 3))
    moved, gradients = points_map(points, 2.0, none)
    np.testing.assert_allclose(moved, points, atol=1e-12)
    np.testing.assert_allclose(gradients, np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-12)


@pytest.mark.parametrize("factor", [0.3, 0.8, 1.5, 2.5])
def test_barrels_keep_the_volume_of_a_cylinder(factor: float) -> None:
    rng = np.random.default_rng(4)
    points = rng.uniform([-1, -0.5, -0.5], [1, 0.5, 0.5], (200_000, 3))
    _, gradients = barrel_points(points, 2.0, factor)
    assert np.linalg.det(gradients).mean() == pytest.approx(1.0, abs=0.01)
    assert np.linalg.det(gradients).min() > 0


def test_the_axis_is_found_and_spans_the_body(rod: GaussianModel) -> None:
    axes = longest_axis(rod)
    np.testing.assert_allclose(np.abs(axes.frame[0]), [0, 1, 0])
    assert np.linalg.det(axes.frame) == pytest.approx(1.0)
    assert axes.length == pytest.approx(1.96, abs=0.02)
    assert axes.center[1] == pytest.approx(2.0, abs=0.02)


def test_bend_turns_the_ends_and_keeps_the_length_of_the_middle_fibre(rod: GaussianModel) -> None:
    bent = bend(rod, 90.0, toward=(1, 0, 0))
    path = bent.means[:101].astype(np.float64)
    first, last = path[1] - path[0], path[-1] - path[-2]
    for tangent, sign in ((first, -1), (last, 1)):  # a bow whose ends stand up towards +x
        angle = np.degrees(np.arctan2(tangent[0], tangent[1]))
        assert angle == pytest.approx(sign * 45, abs=0.5)
    pieces = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert pieces.sum() == pytest.approx(2.0, abs=0.01)  # the middle fibre is neutral
    np.testing.assert_allclose(path[50], rod.means[50], atol=0.01)


def test_twist_turns_top_against_bottom(rod: GaussianModel) -> None:
    twisted = twist(rod, 120.0)
    angle = np.arctan2(*(rod.means - [1, 2, 3])[:, [0, 2]].T)
    after = np.arctan2(*(twisted.means - [1, 2, 3])[:, [0, 2]].T)
    turned = np.degrees(np.angle(np.exp(1j * (after - angle))))
    top, bottom = rod.means[:, 1] > 2.95, rod.means[:, 1] < 1.05
    assert np.median(turned[top]) == pytest.approx(60, abs=4)
    assert np.median(turned[bottom]) == pytest.approx(-60, abs=4)
    np.testing.assert_allclose(twisted.means[:, 1], rod.means[:, 1], atol=1e-5)


def test_squash_changes_length_and_width(rod: GaussianModel) -> None:
    flat = squash(rod, 0.4)
    middle = np.abs(rod.means[:, 1] - 2) < 0.1
    assert np.ptp(np.quantile(flat.means[:, 1], [0.01, 0.99])) == pytest.approx(0.6 * 1.96, abs=0.03)
    ratio = np.abs(flat.means[middle, 0] - 1).mean() / np.abs(rod.means[middle, 0] - 1).mean()
    assert ratio > 1.2


@pytest.mark.parametrize("name", ["bend", "twist", "squash"])
def test_attacks_carry_the_covariances_along(name: str, rod: GaussianModel) -> None:
    """Three neighbors at a thousandth of the body's length tell what the map did to a Gaussian's surroundings."""
    chosen = np.arange(150, 2000, 120)
    step = 2e-3
    probes = [rod.take(chosen).with_(means=rod.means[chosen] + step * e) for e in np.eye(3)]
    parts = [rod, *probes]
    names = ("means", "log_scales", "quats", "opacity_logits", "sh")
    both = GaussianModel(*(np.concatenate([getattr(part, n) for part in parts]) for n in names))
    moved = model_attack(name).apply(both, rng=1)
    assert np.abs(moved.means - both.means).max() > 0.05
    axes = longest_axis(both)
    for rank, i in enumerate(chosen):
        if abs(abs((rod.means[i] - axes.center) @ axes.frame[0]) - 0.5 * axes.length) < 2 * step:
            continue  # at the end itself, where the map has a kink
        near = 2000 + rank + len(chosen) * np.arange(3)
        F = (moved.means[near].astype(np.float64) - moved.means[i]).T / step
        expected = deformed_covariance(rod, i, F)
        np.testing.assert_allclose(covariance(moved, i), expected, atol=0.01 * np.abs(expected).max())
        assert np.abs(covariance(rod, i) - expected).max() > 0.02 * np.abs(expected).max()


def test_unfit_strengths_and_directions_are_refused(rod: GaussianModel) -> None:
    for call, message in (
        (lambda: squash(rod, 1.0), "share"),
        (lambda: squash(rod, -0.1), "share"),
        (lambda: bend(rod, float("nan")), "finite"),
        (lambda: bend(rod, 10.0, toward=(0, 2, 0)), "across"),
        (lambda: bend(rod, 10.0, toward=(0, np.inf, 0)), "finite"),
        (lambda: twist(rod.take(np.arange(0)), 10.0), "empty"),
    ):
        with pytest.raises(InputError, match=message):
            call()
