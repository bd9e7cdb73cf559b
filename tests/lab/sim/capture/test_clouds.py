"""From clouds to kernels: thinning, strays, flat kernels on surfaces, and whole files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.points.cloud import PointCloud
from engine.lab.sim.capture import scans
from engine.lab.sim.capture.capture_kernels import flat_kernels_from_points
from engine.lab.sim.capture.scans import drop_strays, points_to_model, thin_voxels, typical_spacing
from engine.numerics.similarity import quaternion_to_rotation
from tests.formats.point_files import las, ply
from tests.lab.sim.capture.rooms import room_points


def thinned_slowly(cloud: PointCloud, size: float) -> dict[tuple[int, ...], np.ndarray]:
    """Mean of place, color, intensity and time in each voxel, one point after the other."""
    held: dict[tuple[int, ...], list[np.ndarray]] = {}
    low = cloud.points.min(axis=0)
    for k in range(len(cloud)):
        row = np.concatenate([cloud.points[k], cloud.colors[k], cloud.intensity[k : k + 1], cloud.times[k : k + 1]])
        held.setdefault(tuple(((cloud.points[k] - low) // size).astype(int)), []).append(row)
    return {voxel: np.mean(rows, axis=0) for voxel, rows in held.items()}


def test_voxels_against_the_slow_twin() -> None:
    rng = np.random.default_rng(0)
    n = 3000
    cloud = PointCloud(rng.uniform(-2, 3, (n, 3)) + 1e5, rng.random((n, 3)), rng.random(n) * 100, rng.random(n) + 1e9)
    thin = thin_voxels(cloud, 0.7)
    expected = thinned_slowly(cloud, 0.7)
    assert len(thin) == len(expected) < n
    rows = np.array([expected[voxel] for voxel in sorted(expected)])
    np.testing.assert_allclose(thin.points, rows[:, :3], atol=1e-8)
    np.testing.assert_allclose(thin.colors, rows[:, 3:6], atol=1e-6)
    np.testing.assert_allclose(thin.intensity, rows[:, 6], rtol=1e-6)
    np.testing.assert_allclose(thin.times, rows[:, 7], rtol=1e-15)


def test_voxels_that_cannot_be() -> None:
    cloud = PointCloud(np.array([[0.0, 0, 0], [1e6, 1e6, 1e6]]))
    with pytest.raises(InputError, match="size of a voxel is 0"):
        thin_voxels(cloud, 0.0)
    with pytest.raises(InputError, match="too small"):
        thin_voxels(cloud, 1e-3)


def test_spacing_of_a_grid() -> None:
    x, y = np.meshgrid(np.arange(60) * 0.25, np.arange(60) * 0.25)
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    assert typical_spacing(points) == pytest.approx(0.25, rel=0.3)
    lines = points * [0.1, 1.0, 1.0]  # ten times as dense along the rings
    assert typical_spacing(lines) > 2.0 * 0.025  # not the distance along the ring
    assert typical_spacing(np.zeros((1, 3))) == 0.0


def test_strays_go_and_surfaces_stay() -> None:
    rng = np.random.default_rng(1)
    points = room_points(6000)[0]
    lone = rng.uniform([-4, -3, 10], [4, 3, 60], (12, 3))  # sky
    echoes = np.array([0.0, 0.0, -3.0]) + 0.03 * rng.standard_normal((3, 3))  # under the ground, together
    order = rng.permutation(len(points) + 15)
    cloud = PointCloud(
        np.concatenate([points, lone, echoes])[order],
        intensity=np.concatenate([np.zeros(len(points)), np.ones(15)])[order],
    )
    clean = drop_strays(cloud)
    assert clean.intensity is not None
    assert clean.intensity.sum() == 0.0
    assert 15 <= len(cloud) - len(clean) <= 15 + 0.02 * len(points)
    few = PointCloud(np.eye(3))
    assert drop_strays(few) is few


def test_flat_kernels_lie_on_the_surface() -> None:
    rng = np.random.default_rng(2)
    normal = rng.standard_normal((4000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    model = flat_kernels_from_points(5.0 * normal, np.full((4000, 3), 0.5))
    third = quaternion_to_rotation(model.quats)[:, :, 2]
    assert np.median(np.abs((third * normal).sum(axis=1))) > 0.99
    own_radius = np.sqrt(4 * np.pi * 25 / 4000 / np.pi)  # of the disc that a point has for itself
    wide = np.sqrt(model.scales[:, 0] * model.scales[:, 1])
    assert np.median(wide) == pytest.approx(own_radius, rel=0.15)
    assert np.median(model.scales[:, 2] / wide) < 0.15


def test_flat_kernels_of_points_in_one_place_and_on_a_line() -> None:
    points = np.zeros((30, 3))
    points[10:, 0] = np.arange(20.0)
    model = flat_kernels_from_points(points, np.full((30, 3), 0.5))
    assert np.isfinite(model.log_scales).all()
    np.testing.assert_allclose(np.linalg.norm(model.quats, axis=1), 1.0, atol=1e-6)


def test_a_cloud_on_a_map_grid_gets_an_origin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """UTM coordinates: float32 would put the points on a lattice of half a metre."""
    monkeypatch.setattr(scans, "drop_strays", lambda cloud: cloud)
    points, colors = room_points(800)
    points = np.round((points + np.array([500_000.0, 5_400_000.0, 300.0])) * 8) / 8
    file = tmp_path / "town.las"
    file.write_bytes(las(points, np.round(255 * colors).astype(np.uint8)))
    made = points_to_model(file)
    np.testing.assert_allclose(made.model.means + made.origin, points, atol=1e-5)
    assert abs(made.origin[1] - 5_400_000.0) < 10.0
    np.testing.assert_allclose(0.5 + 0.28209479 * made.model.sh[:, 0], colors, atol=0.003)


def test_as_many_points_as_a_model_has_at_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points, colors = room_points(2000)
    file = tmp_path / "room.ply"
    file.write_bytes(ply(points, np.round(255 * colors).astype(np.uint8)))
    plain = points_to_model(file)
    assert 0.97 * len(points) < len(plain.model) <= len(points)
    assert (plain.origin == 0).all()
    assert plain.voxel == 0
    assert plain.model.opacities.min() == pytest.approx(0.95)
    monkeypatch.setattr(scans, "MOST", 500)
    few = points_to_model(file)
    assert 100 < len(few.model) <= 500
    assert few.voxel > 0


def test_grey_by_intensity_where_there_are_no_colors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scans, "drop_strays", lambda cloud: cloud)
    points, _ = room_points(400)
    file = tmp_path / "grey.las"
    file.write_bytes(las(points, format=1))
    made = points_to_model(file)
    assert made.colors_from == "intensity"
    shades = 0.5 + 0.28209479 * made.model.sh[:4, 0]  # intensities 0, 7, 250, 65
    np.testing.assert_allclose(shades, np.repeat([[0.0], [7 / 250], [1.0], [65 / 250]], 3, axis=1), atol=0.01)
