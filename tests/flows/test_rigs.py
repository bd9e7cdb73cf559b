from __future__ import annotations

import numpy as np
import pytest

from engine.flows.views import camera_rig as rigs
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.model import GaussianModel


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


@pytest.mark.parametrize("count", [1, 50])
def test_a_single_place_is_looked_at_from_all_around(count: int) -> None:
    cameras = make_rig(blank(np.ones((count, 3))), 3, 32, 32)
    for camera in cameras:
        seen = camera.viewmat[:3, :3] @ np.ones(3) + camera.viewmat[:3, 3]
        assert seen[2] > 0
        np.testing.assert_allclose((camera.K @ (seen / seen[2]))[:2], 16.0, atol=1e-3)
    forward = np.array([camera.viewmat[2, :3] for camera in cameras])
    assert (forward @ forward.T + np.eye(3) * -2 < 0.9).all(), "no two from one side"


def test_quantiles_are_weighted() -> None:
    values, weights = np.array([3.0, 1.0, 2.0, 4.0]), np.array([1.0, 6.0, 1.0, 2.0])
    assert [rigs._weighted_quantile(values, weights, q) for q in (0.5, 0.65, 0.75, 0.95)] == [1.0, 2.0, 3.0, 4.0]


def test_what_nobody_sees_and_the_sky_do_not_move_the_model() -> None:
    """Faint Gaussians and a handful of huge ones far away count for little, however many or large."""
    ball = blank(np.random.default_rng(1).standard_normal((3000, 3)))
    clean = measure_extent(ball)
    means = np.concatenate([ball.means, [[300.0, 0, 0]] * 3, np.full((3000, 3), -40.0)])
    around = blank(means).with_(
        log_scales=np.concatenate([np.full((3000, 3), -3.0), np.full((3, 3), 4.0), np.full((3000, 3), -3.0)]),
        opacity_logits=np.concatenate([np.zeros(3003), np.full(3000, -9.0)]),
    )
    extent = measure_extent(around)
    assert np.linalg.norm(extent.center - clean.center) < 0.2
    assert extent.radius == pytest.approx(clean.radius, rel=0.1)


@pytest.mark.parametrize("jittered", [False, True])
def test_views_go_all_around_and_from_low_to_high(jittered: bool) -> None:
    ball = blank(np.random.default_rng(1).standard_normal((3000, 3)))
    jitter = np.random.default_rng(2).random((12, 4)) if jittered else None
    extent = measure_extent(ball)
    eyes = np.array([camera.position - extent.center for camera in make_rig(ball, 12, 64, 64, jitter=jitter)])
    for count in (4, 8, 12):  # any prefix of the rig
        azimuth = np.sort(np.arctan2(eyes[:count, 2], eyes[:count, 0]))
        gaps = np.diff(np.concatenate([azimuth, azimuth[:1] + 2 * np.pi]))
        assert gaps.max() < 2.5 * 2 * np.pi / count
    elevation = np.degrees(np.arcsin(-eyes[:, 1] / np.linalg.norm(eyes, axis=1)))
    assert (np.diff(elevation) > 0).all()
    assert elevation[0] < 14
    assert elevation[-1] > 49


def test_ground_needs_fewer_views_half_as_dense() -> None:
    means = np.random.default_rng(1).standard_normal((4000, 3))
    ball, ground = (measure_extent(blank(means * shape)) for shape in ([1, 1, 1], [1, 0.05, 1]))
    assert ball.fewer(48) == 48
    assert ball.fewer(3) == 3
    assert ground.fewer(48) == 14
    assert ground.fewer(1) == 1
    assert measure_extent(shell(4000, 5.0)).fewer(48) == 48
    nearest = []
    for extent, flat in ((ball, 1.0), (ground, 0.05)):
        rig = make_rig(blank(means * [1, flat, 1]), extent.fewer(48), 64, 64, extent=extent)
        toward = np.array([(camera.position - extent.center) for camera in rig])
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        cosine = toward @ toward.T - 2.0 * np.eye(len(toward))
        nearest.append(float(np.median(np.arccos(cosine.max(axis=1)))))
    assert nearest[1] == pytest.approx(np.sqrt(2.0) * nearest[0], rel=0.15)
