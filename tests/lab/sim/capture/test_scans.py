"""Scans and their path: every point lands where it was seen, and a model of them looks like the scene."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.lab.points.cloud import PointCloud
from engine.lab.points.trajectory import Trajectory
from engine.lab.sim.capture import scans as capture
from engine.lab.sim.capture.lidar import Lidar, scan_model
from engine.lab.sim.capture.scans import (
    Scan,
    join_clouds,
    place_scan,
    place_scans,
    poses_at,
    read_scans,
    scans_to_model,
)
from engine.model import Float64, GaussianModel, look_at
from engine.numerics.image_metrics import psnr
from engine.numerics.similarity import rotation_to_quaternion
from engine.raster import render
from tests.formats.point_files import pcd, ply
from tests.lab.sim.capture.rooms import from_surface, room, room_points, walk

LIDAR = Lidar(rings=32, columns=240, lowest=-45.0, highest=40.0, farthest=20.0)


@cache
def scanned() -> tuple[GaussianModel, Trajectory, tuple[Scan, ...]]:
    model, path = room(), walk(6)
    return model, path, tuple(scan_model(model, path, LIDAR))


def seen_from(point: Float64, path: Trajectory, times: Float64) -> Float64:
    """A fixed point of the world, in the frame of a moving sensor at those times: (M, 3)."""
    rows = []
    for time in times:
        k = int(np.clip(np.searchsorted(path.times, time) - 1, 0, len(path) - 2))
        part = (time - path.times[k]) / (path.times[k + 1] - path.times[k])
        ends = Rotation.from_quat(np.roll(path.quats[k : k + 2], -1, axis=1))
        turn = ends[0] * Rotation.from_rotvec(part * (ends[0].inv() * ends[1]).as_rotvec())
        place = path.positions[k] + part * (path.positions[k + 1] - path.positions[k])
        rows.append(turn.inv().apply(point - place))
    return np.array(rows)


def test_a_fixed_point_seen_on_the_way_stays_one_point() -> None:
    path, target = walk(9), np.array([0.3, -2.0, 1.0])
    times = np.sort(np.random.default_rng(0).uniform(100.0, 100.8, 200))
    seen = seen_from(target, path, times)
    assert np.ptp(seen, axis=0).min() > 0.1  # the sensor really moved
    placed, outside = place_scan(Scan(PointCloud(seen, times=times)), path)
    np.testing.assert_allclose(placed.points, np.tile(target, (200, 1)), atol=1e-12)
    assert outside == 0


def test_times_that_count_from_the_scan() -> None:
    path, target = walk(9), np.array([0.3, -2.0, 1.0])
    times = np.linspace(100.3, 100.4, 20)
    scan = Scan(PointCloud(seen_from(target, path, times), times=times - 100.3 + 7.0), "s", time=100.3)
    np.testing.assert_allclose(place_scan(scan, path)[0].points, np.tile(target, (20, 1)), atol=1e-12)


def test_points_before_and_after_the_path_are_left_out() -> None:
    path = walk(9)
    times = np.array([99.0, 100.1, 100.2, 101.0])
    cloud = PointCloud(np.arange(12.0).reshape(4, 3), times=times, intensity=np.arange(4.0))
    placed, outside = place_scan(Scan(cloud), path)
    assert outside == 2
    np.testing.assert_array_equal(placed.intensity, [1.0, 2.0])
    with pytest.raises(InputError, match="lie outside the trajectory"):
        place_scan(Scan(cloud.take(np.array([0, 3])), "late"), path)


def test_poses_at_the_poses_themselves() -> None:
    path = walk(7)
    rotations, positions = poses_at(path, path.times)
    np.testing.assert_allclose(rotations.as_matrix(), path.matrices[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(positions, path.positions, atol=1e-12)
    with pytest.raises(InputError, match="outside the trajectory"):
        poses_at(path, np.array([99.9]))
    with pytest.raises(InputError, match="holds no times"):
        poses_at(walk(7, times=False), path.times)


def test_scans_with_stamps_that_start_anew_are_not_piled_up() -> None:
    """Stamps 0 to 0.1 in every file, a path that starts at 0: only the order tells when a scan was taken."""
    path = walk(5)
    path = replace(path, times=path.times - 100.0)
    stamps = np.linspace(0.0, 0.1, 10)
    target = np.array([0.3, -2.0, 1.0])
    scans = [Scan(PointCloud(seen_from(target, path, time + stamps), times=stamps)) for time in path.times[:-1]] + [
        Scan(PointCloud(seen_from(target, path, path.times[-1:]), times=stamps[:1]))
    ]
    clouds, outside = place_scans(scans, path)
    np.testing.assert_allclose(join_clouds(clouds).points, np.tile(target, (41, 1)), atol=1e-9)
    assert outside == 0


def test_scans_and_poses_that_do_not_belong_together() -> None:
    scan = Scan(PointCloud(np.zeros((3, 3))))
    with pytest.raises(InputError, match="2 scans for 5 poses without times"):
        place_scans([scan] * 2, walk(5, times=False))
    with pytest.raises(InputError, match="unknown when the 2 scans were taken"):
        place_scans([scan] * 2, walk(5))


def test_joined_clouds_keep_what_all_of_them_know() -> None:
    points = np.zeros((2, 3))
    full, bare = PointCloud(points, points, points[:, 0], points[:, 0]), PointCloud(points, points)
    both = join_clouds([full, bare])
    assert len(both) == 4
    assert both.colors is not None
    assert both.intensity is None
    assert both.times is None
    with pytest.raises(InputError, match="no clouds"):
        join_clouds([])


def test_the_scanner_measures_the_surfaces() -> None:
    _, path, scans = scanned()
    clouds, _ = place_scans(scans, path)
    distance = from_surface(join_clouds(clouds).points)
    assert np.median(distance) < 0.02
    assert np.quantile(distance, 0.95) < 0.15
    assert min(len(scan.cloud) for scan in scans) > 0.5 * LIDAR.rings * LIDAR.columns


def test_noise_is_along_the_beam_and_repeats() -> None:
    model, path, scans = scanned()
    one = Trajectory(path.positions[:1], path.quats[:1], path.times[:1])
    noisy, again = (scan_model(model, one, replace(LIDAR, noise=0.05), seed=3)[0].cloud for _ in range(2))
    np.testing.assert_array_equal(noisy.points, again.points)
    clean = scans[0].cloud.points
    error = np.linalg.norm(noisy.points, axis=1) - np.linalg.norm(clean, axis=1)
    assert 0.045 < error.std() < 0.055
    np.testing.assert_allclose(np.cross(noisy.points, clean), 0.0, atol=1e-10)


def test_a_scanner_that_sees_nothing_says_so() -> None:
    model, path, _ = scanned()
    with pytest.raises(InputError, match="no beam of the scan at pose 0"):
        scan_model(model, replace(path, positions=path.positions + 1e4), LIDAR)
    with pytest.raises(InputError, match="elevations"):
        Lidar(lowest=10.0, highest=-10.0)


def write(folder: Path, clouds: list[PointCloud], stems: list[str]) -> Path:
    folder.mkdir()
    for cloud, stem in zip(clouds, stems, strict=True):
        shades = np.round(255 * cloud.colors).astype(np.uint8)
        (folder / f"{stem}.pcd").write_bytes(pcd(cloud.points, shades).replace(b" intensity t\n", b" intensity u\n"))
    return folder


@pytest.mark.parametrize("kind", ["kitti", "tum by name", "tum by order"])
def test_from_files_to_a_model_that_looks_like_the_scene(kind: str, tmp_path: Path) -> None:
    model, path, scans = scanned()
    stems = [f"{time:.6f}" if kind == "tum by name" else f"{k:04d}" for k, time in enumerate(path.times)]
    folder = write(tmp_path / "scans", [scan.cloud for scan in scans], stems)
    if kind == "kitti":
        table = path.matrices[:, :3].reshape(-1, 12)
    else:
        table = np.column_stack([path.times, path.positions, np.roll(path.quats, -1, axis=1)])
    np.savetxt(tmp_path / "poses.txt", table, fmt="%.17g")
    made = scans_to_model(folder, tmp_path / "poses.txt")
    camera = look_at((-1.3, 0.5, 1.6), (4.0, -0.5, 1.2), (0, 0, 1), 100.0, 160, 120)
    truth = np.clip(render(model, camera), 0.0, 1.0)
    right = psnr(truth, np.clip(render(made.model, camera), 0.0, 1.0))
    assert right > 22.0
    assert made.voxel > 0.0
    assert made.colors_from == "colors"
    assert len(made.model) == len(made.cloud) < made.points_read
    still = replace(path, positions=np.tile(path.positions[:1], (6, 1)), times=None)
    wrong = scans_to_model(folder, still)
    assert psnr(truth, np.clip(render(wrong.model, camera), 0.0, 1.0)) < right - 3.0


def test_one_file_whose_points_have_times(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points, colors = room_points(500)
    path = Trajectory(
        np.array([[0.0, 0, 0], [1.0, 0, 0]]),
        rotation_to_quaternion(np.tile(np.eye(3), (2, 1, 1))),
        np.array([10.0, 11.0]),
    )
    file = tmp_path / "all.ply"  # times 10, 10.25, 10.5, 11 in turn
    file.write_bytes(ply(points, np.round(255 * colors).astype(np.uint8)))
    monkeypatch.setattr(capture, "drop_strays", lambda cloud: cloud)
    made = scans_to_model(file, path)
    shift = np.resize([0.0, 0.25, 0.5, 1.0], len(points))
    np.testing.assert_allclose(made.cloud.points, points + shift[:, None] * [1, 0, 0], atol=1e-12)


def test_names_that_are_times(tmp_path: Path) -> None:
    cloud = PointCloud(np.eye(3), np.eye(3, dtype=np.float32))
    folder = write(
        tmp_path / "s", [cloud] * 3, ["1699999999.250000", "1700000000123456789", "000012"]
    )  # sorted: the last comes first
    (folder / "notes.txt").write_text("no scan")
    scans = read_scans(folder)
    assert [scan.time for scan in scans] == [None, 1699999999.25, pytest.approx(1700000000.123456789)]
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="holds no scans"):
        read_scans(empty)
