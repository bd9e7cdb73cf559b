"""Kernels from points: against the definition, point by point."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.capture.capture_kernels import kernels_from_points
from engine.numerics.spherical_harmonics import sh_basis


def cloud(count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.normal(5.0, 2.0, (count, 3)), rng.uniform(0.0, 1.0, (count, 3))


def test_against_the_definition() -> None:
    points, colors = cloud()
    model = kernels_from_points(points, colors)
    for i, point in enumerate(points):
        others = np.sort(np.linalg.norm(np.delete(points, i, axis=0) - point, axis=1))[:3]
        assert model.scales[i] == pytest.approx(np.full(3, np.sqrt(np.mean(others**2))), rel=1e-5)
    np.testing.assert_allclose(model.means, points, rtol=1e-6)
    np.testing.assert_allclose(model.opacities, 0.1, rtol=1e-5)
    shown = 0.5 + model.sh[:, 0] * sh_basis(np.array([[0.0, 0.0, 1.0]]), 0)[0, 0]
    np.testing.assert_allclose(shown, colors, atol=1e-6)
    assert (model.quats == [1, 0, 0, 0]).all()


def test_bytes_and_opacity() -> None:
    points, colors = cloud()
    shades = np.round(colors * 255).astype(np.uint8)
    plain, other = kernels_from_points(points, shades / 255.0), kernels_from_points(points, shades)
    np.testing.assert_allclose(plain.sh, other.sh, atol=1e-6)
    solid = kernels_from_points(points, colors, opacity=0.9)
    np.testing.assert_allclose(solid.opacities, 0.9, rtol=1e-5)
    np.testing.assert_array_equal(solid.scales, plain.scales)


def test_points_at_one_place_have_a_size() -> None:
    points, colors = cloud()
    points[:8] = points[0]
    model = kernels_from_points(points, colors)
    assert np.isfinite(model.log_scales).all()
    assert 0.0 < model.scales[0, 0] < 0.01 * np.median(model.scales)
    assert (kernels_from_points(np.zeros((5, 3)), np.zeros((5, 3))).scales > 0).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p, c: (p[:3], c[:3]), "at least 4 points, got 3"),
        (lambda p, c: (p, c[:5]), "expected"),
        (lambda p, c: (np.where(np.arange(60)[:, None] == 7, np.nan, p), c), "points: row 7 is not finite"),
        (lambda p, c: (p, c * 255), "expected 0 to 1 or uint8"),
    ],
)
def test_refusals(change, message: str) -> None:
    with pytest.raises(InputError, match=message):
        kernels_from_points(*change(*cloud()))


def test_refused_options() -> None:
    with pytest.raises(InputError, match=r"opacity is 1\.0"):
        kernels_from_points(*cloud(), opacity=1.0)
