"""From matches to a camera: motions, hypotheses, and the acceleration of their refinement."""

from __future__ import annotations

import numpy as np
import pytest

from engine.model import Camera, look_at
from engine.pictures.camera.camera_motion import PARAMETERS, moved, normalized, point_columns, project
from engine.pictures.camera.pose_ransac import fit_camera, hypothesize
from engine.pictures.camera.pose_refinement import Acceleration

UP = np.array([0.0, -1.0, 0.0])


def cloud(rng: np.random.Generator, count: int) -> tuple[np.ndarray, Camera]:
    camera = look_at((0.5, -1.0, -4.0), (0.0, 0.1, 0.0), UP, 500.0, 640, 480)
    return rng.uniform(-1.0, 1.0, (count, 3)), camera


def test_columns_are_the_derivative_of_the_motion() -> None:
    points, camera = cloud(np.random.default_rng(1), 20)
    rays, depth = normalized(points, camera)
    columns = point_columns(rays, depth / 3.0, camera.K)
    for k in range(PARAMETERS):
        step = np.zeros(PARAMETERS)
        step[k] = 1e-6
        ahead, behind = (project(points, moved(camera, s * step, 3.0)) for s in (1.0, -1.0))
        np.testing.assert_allclose(columns[:, :, k], (ahead - behind) / 2e-6, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("focal", [0.55, 0.9, 1.3, 1.9])
def test_camera_is_found_among_wrong_matches(focal: float) -> None:
    rng = np.random.default_rng(2)
    points, camera = cloud(rng, 200)
    camera = look_at(
        camera.position * focal / 0.8, (0.0, 0.1, 0.0), UP + np.array([0.3, 0.0, 0.1]), 640 * focal, 640, 480
    )
    pixels = project(points, camera) + rng.normal(0.0, 0.5, (200, 2))
    wrong = rng.random(200) < 0.6
    pixels[wrong] = rng.uniform(0.0, 480.0, (int(wrong.sum()), 2))
    found = hypothesize(points, pixels, 640, 480, 3.0, 12)
    assert found is not None
    assert found.support >= 0.9 * (~wrong).sum()
    assert np.sqrt(np.mean((project(points, found.camera) - project(points, camera)) ** 2)) < 0.3
    assert found.camera.K[0, 0] == pytest.approx(640 * focal, rel=0.05)


def test_no_camera_among_random_matches() -> None:
    rng = np.random.default_rng(3)
    for count in (0, 3, 60):
        pixels = rng.uniform(0.0, 480.0, (count, 2))
        assert hypothesize(rng.normal(size=(count, 3)), pixels, 640, 480, 3.0, 12) is None
    assert hypothesize(np.ones((60, 3)), rng.uniform(0.0, 480.0, (60, 2)), 640, 480, 3.0, 12) is None


def test_fit_never_puts_the_scene_behind_the_camera() -> None:
    points, camera = cloud(np.random.default_rng(4), 50)
    behind = look_at(camera.position, 2 * camera.position, UP, 500.0, 640, 480)
    fitted = fit_camera(points, project(points, camera), behind, 3.0)
    assert fitted is None or np.isfinite(fitted.camera.viewmat).all()


def test_acceleration_shortens_a_slow_iteration() -> None:
    rates = np.array([0.9, 0.8, 0.3, 0.2, 0.1, 0.05, 0.5])  # share of the error that a step leaves
    flow = np.eye(7)
    errors = {}
    for accelerated in (False, True):
        state, memory = 0.1 * np.ones(7), Acceleration()
        for _ in range(8):
            motion = -(1.0 - rates) * state
            step = float(np.linalg.norm(motion))
            state = state + (memory.improve(motion, flow, step) if accelerated else motion)
        errors[accelerated] = float(np.linalg.norm(state))
    assert errors[True] < 0.2 * errors[False]


def test_acceleration_leaves_long_steps_alone() -> None:
    memory = Acceleration()
    for scale in (4.0, 3.0, 2.0):
        motion = scale * np.ones(7)
        assert memory.improve(motion, np.eye(7), float(np.linalg.norm(motion))) is motion
