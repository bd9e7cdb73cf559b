"""Cameras for the tests, and their comparison."""

from __future__ import annotations

import numpy as np

from engine.model import Camera, look_at


def cameras(count: int = 3) -> list[Camera]:
    rng = np.random.default_rng(0)
    result = []
    for k in range(count):
        camera = look_at(rng.normal(size=3) * 4, rng.normal(size=3), [0.1, 1, 0.2], 300 + k, 200 + k, 100)
        K = camera.K.copy()
        K[1, 1], K[0, 2] = 310.5, 90.25
        result.append(Camera(camera.viewmat, K, camera.width, camera.height))
    return result


def assert_close(found: list[Camera], expected: list[Camera], tolerance: float = 1e-12) -> None:
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a.viewmat, b.viewmat, atol=tolerance)
        np.testing.assert_allclose(a.K, b.K, rtol=1e-9)
        assert (a.width, a.height) == (b.width, b.height)
