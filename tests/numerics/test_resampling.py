"""Cubic resampling against what a cubic kernel must reproduce exactly."""

from __future__ import annotations

import numpy as np
import pytest

from engine.numerics.resampling import map_points, sample, smooth, warp


def plane(height: int, width: int) -> np.ndarray:
    """A quadratic of the pixel centres: Keys' kernel with a = -1/2 reproduces it exactly away from borders."""
    y, x = np.mgrid[:height, :width] + 0.5
    return quadratic(x, y).astype(np.float32)


def quadratic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(0.2 + 0.01 * x - 0.02 * y + 3e-4 * x * x - 2e-4 * y * y + 1e-4 * x * y)


def test_identity_is_exact() -> None:
    image = np.random.default_rng(0).random((9, 13, 3)).astype(np.float32)
    warped, inside = warp(image, np.eye(3), 9, 13)
    np.testing.assert_array_equal(warped, image)
    assert inside.all()


def test_quadratics_are_reproduced_under_rotation_scale_and_perspective() -> None:
    image = plane(60, 80)
    matrix = np.array([[0.8, -0.3, 21.3], [0.3, 0.8, 4.7], [1e-4, -2e-4, 1.0]])
    warped, inside = warp(image[:, :, None], matrix, 40, 50)
    y, x = np.mgrid[:40, :50] + 0.5
    at = map_points(matrix, np.stack([x.ravel(), y.ravel()], axis=1))
    deep = ((at > 2.5) & (at < np.array([80, 60]) - 2.5)).all(axis=1)
    assert deep.sum() > 1000
    np.testing.assert_allclose(warped[..., 0].ravel()[deep], quadratic(*at[deep].T), atol=2e-5)
    np.testing.assert_allclose(sample(image, at)[deep], quadratic(*at[deep].T), atol=2e-5)
    np.testing.assert_array_equal(inside.ravel(), ((at >= 0) & (at <= [80, 60])).all(axis=1))


def test_outside_is_told() -> None:
    image = np.ones((8, 8, 1), dtype=np.float32)
    warped, inside = warp(image, np.array([[1.0, 0, 4], [0, 1, 0], [0, 0, 1]]), 8, 8)
    assert inside[:, :4].all()
    assert not inside[:, 5:].any()
    assert warped[:, 5:].max() == 0
    assert np.isnan(sample(image[..., 0], np.array([[-0.1, 4.0], [4.0, 8.1]]))).all()


@pytest.mark.parametrize("matrix", [np.full((3, 3), np.nan), np.diag([1.0, 1.0, -1.0]), np.zeros((3, 3))])
def test_senseless_matrices_give_an_empty_picture(matrix: np.ndarray) -> None:
    warped, inside = warp(np.ones((8, 8, 3), dtype=np.float32), matrix, 8, 8)
    assert not inside.any()
    assert warped.max() == 0


def test_points_behind_the_horizon_are_far_outside() -> None:
    matrix = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 1]])
    mapped = map_points(matrix, np.array([[0.5, 0.5], [2.0, 0.5]]))
    np.testing.assert_allclose(mapped[0], [1.0, 1.0])
    assert (mapped[1] == -1e9).all()


def test_smooth_keeps_shape_and_constants() -> None:
    image = np.full((11, 7, 1), 0.3, dtype=np.float32)
    assert smooth(image, 0.0) is image
    assert smooth(image, 1.5).shape == image.shape
    np.testing.assert_allclose(smooth(image, 1.5), 0.3, atol=1e-6)
