from __future__ import annotations

import numpy as np
import pytest

from engine.model import GaussianModel
from engine.pipeline.rigs import make_rig, measure_extent


def shell(n: int, radius: float, seed: int = 0) -> GaussianModel:
    """Gaussians on a sphere (a room's walls)."""
    rng = np.random.default_rng(seed)
    means = rng.standard_normal((n, 3))
    means *= radius / np.linalg.norm(means, axis=1, keepdims=True)
    return blank(means)


def blank(means: np.ndarray) -> GaussianModel:
    n = len(means)
    return GaussianModel(
        means, np.full((n, 3), -3.0), np.tile([1.0, 0, 0, 0], (n, 1)), np.zeros(n), np.zeros((n, 1, 3))
    )


def test_rooms_are_seen_from_inside_and_objects_from_outside() -> None:
    room, ball = shell(4000, 5.0), blank(np.random.default_rng(1).standard_normal((4000, 3)))
    inside, outside = measure_extent(room), measure_extent(ball)
    assert inside.is_room
    assert not outside.is_room
    for camera in make_rig(room, 8, 64, 64):
        assert np.linalg.norm(camera.position - inside.center) < 0.5 * inside.radius
    for camera in make_rig(ball, 8, 64, 64):
        assert np.linalg.norm(camera.position - outside.center) > 1.5 * outside.radius


def test_extent_ignores_floaters() -> None:
    rng = np.random.default_rng(2)
    means = rng.standard_normal((5000, 3))
    clean = measure_extent(blank(means))
    means[:20] *= 1e4
    dirty = measure_extent(blank(means))
    assert np.linalg.norm(dirty.center - clean.center) < 0.2
    assert dirty.radius == pytest.approx(clean.radius, rel=0.1)


def test_the_object_fills_the_views(plant: GaussianModel) -> None:
    extent = measure_extent(plant)
    for camera in make_rig(plant, 5, 100, 100):
        x = camera.viewmat[:3, :3] @ extent.center + camera.viewmat[:3, 3]
        u = camera.K @ (x / x[2])
        assert abs(u[0] - 50) < 12
        assert abs(u[1] - 50) < 12
        assert 0.3 < camera.K[0, 0] * extent.radius / x[2] / 50 < 1.1


def test_jitter_moves_every_camera_and_the_plain_rig_is_fixed(plant: GaussianModel) -> None:
    plain = make_rig(plant, 4, 64, 64)
    again = make_rig(plant, 4, 64, 64)
    moved = make_rig(plant, 4, 64, 64, jitter=np.random.default_rng(0).random((4, 4)))
    for a, b, c in zip(plain, again, moved, strict=True):
        np.testing.assert_array_equal(a.viewmat, b.viewmat)
        assert np.abs(a.viewmat - c.viewmat).max() > 1e-3


def test_one_gaussian_and_identical_gaussians_give_finite_cameras() -> None:
    for count in (1, 50):
        for camera in make_rig(blank(np.ones((count, 3))), 3, 32, 32):
            assert np.isfinite(camera.viewmat).all()
