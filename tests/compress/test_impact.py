"""Impact and curvature against their slow twins."""

from __future__ import annotations

import numpy as np
import pytest

from engine.compress.config import CONFIG
from engine.compress.impact import (
    frequency_impact,
    measure_impact,
    paper_impact,
    sh_curvature,
    spatial_coherence,
    uncertain,
    uncertainty,
)
from engine.model import Camera, GaussianModel, look_at
from engine.raster import prepare_view, render
from tests.raster.scenes import random_model
from tests.reference import impact as slow

CAMERAS = [
    look_at((0.5, -1.0, -4.6), (0.0, 0.4, 0.0), (0.0, -1.0, 0.0), 60.0, 48, 44),
    look_at((4.0, -0.5, 1.0), (0.2, 0.0, 0.0), (0.0, -1.0, 0.0), 50.0, 40, 48),
]


@pytest.fixture(scope="module")
def model() -> GaussianModel:
    return random_model(60, 3)


def images(model: GaussianModel) -> list[np.ndarray]:
    return [render(model, camera) for camera in CAMERAS]


def relative(got: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(got - expected) / np.linalg.norm(expected))


def test_impact_is_equation_4(model: GaussianModel) -> None:
    found = measure_impact(model, [prepare_view(model, camera) for camera in CAMERAS], images(model))
    weights = [slow.blending_weights(model, camera) for camera in CAMERAS]
    per_view = np.stack([w.sum(axis=(1, 2)) for w in weights])  # (V, N)
    assert relative(paper_impact(model, found), slow.impact(model, CAMERAS, images(model))) < 1e-3
    assert relative(found.per_view, per_view) < 1e-3
    assert relative(found.coverage, per_view.sum(axis=0)) < 1e-3
    assert relative(found.squared, sum((w**2).sum(axis=(1, 2)) for w in weights)) < 1e-3


def test_who_covers_only_smooth_pixels_has_no_impact() -> None:
    """Eq 4's second factor: a wall without texture may go, an edge may not."""
    model = random_model(30, 5)
    view, flat = prepare_view(model, CAMERAS[0]), np.full((44, 48, 3), 0.4, np.float32)
    assert not paper_impact(model, measure_impact(model, [view], [flat])).any()
    flat[:, 23:] = 0.8
    assert paper_impact(model, measure_impact(model, [view], [flat])).any()


def test_who_is_alone_has_little_impact() -> None:
    """Eq 4's third factor, on Gaussians that differ in nothing but their distance to the next one."""
    line = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 15.0])  # distances 1, the last one 10: five times sigma
    model = random_model(7, 0).with_(means=np.stack([line, 0 * line, 0 * line], axis=1).astype(np.float32))
    expected = np.exp(-0.5 * np.array([0.5] * 6 + [5.0]) ** 2)
    np.testing.assert_allclose(spatial_coherence(model), expected, rtol=1e-5)
    np.testing.assert_allclose(slow.coherence(model.means.astype(np.float64)), expected, rtol=1e-5)
    assert spatial_coherence(model.take(np.arange(1))).tolist() == [1.0]


@pytest.mark.parametrize("coefficients", [1, 4, 16])
def test_curvature_is_the_diagonal_of_gauss_and_newton(coefficients: int) -> None:
    model = random_model(40, 8, coefficients)
    views = [prepare_view(model, camera) for camera in CAMERAS]
    assert relative(sh_curvature(model, views, CAMERAS), slow.curvature(model, CAMERAS)) < 1e-3


def test_curvature_is_the_second_derivative_of_the_render_error() -> None:
    """One coefficient of one Gaussian moved by a little costs, in each channel, H times the square of the step."""
    model = random_model(12, 9, 4)
    model = model.with_(sh=(0.1 * model.sh).astype(np.float32))  # no colour near the clamp at 0
    camera: Camera = CAMERAS[0]
    H = sh_curvature(model, [prepare_view(model, camera)], [camera])
    plain = render(model, camera)
    for row, coefficient in [(int(H[:, k].argmax()), k) for k in range(4)]:
        sh = model.sh.copy()
        sh[row, coefficient] += 0.1
        error = float(((render(model.with_(sh=sh), camera) - plain).astype(np.float64) ** 2).sum())
        assert error == pytest.approx(3 * H[row, coefficient] * 0.1**2, rel=1e-2)


def test_uncertainty_is_the_posterior_variance() -> None:
    np.testing.assert_allclose(uncertainty(np.array([0.0, 1.0, 9.0]), prior=1.0), [1.0, 0.5, 0.1])
    assert uncertainty(np.zeros(1)) == pytest.approx(1 / CONFIG.prior), "unseen, yet finite"


def test_frequency_impact_is_eq_4_times_the_detail_of_the_colour() -> None:
    """W^freq, with the detail as loops over pairs of coefficients; of DC alone it is Eq 4."""
    model = random_model(40, 8, 9)
    found = measure_impact(model, [prepare_view(model, CAMERAS[0])], images(model)[:1])
    detail = np.zeros(40)
    for pair in range(4):
        detail += ((model.sh[:, 2 * pair] - model.sh[:, 2 * pair + 1]).astype(np.float64) ** 2).sum(axis=1) / 2
    np.testing.assert_allclose(frequency_impact(model, found), paper_impact(model, found) * np.sqrt(detail), rtol=1e-5)
    plain = model.with_(sh=model.sh[:, :1])
    np.testing.assert_array_equal(frequency_impact(plain, found), paper_impact(plain, found))


def test_uncertain_is_what_lies_deviations_above_the_mean() -> None:
    curvature = np.ones((100, 4))
    curvature[:5, 2] = 0.1
    doubt = 1 / (curvature + CONFIG.prior)
    far = (1 / (0.1 + CONFIG.prior) - doubt.mean()) / doubt.std()
    np.testing.assert_array_equal(uncertain(curvature, 0.9 * far), curvature == 0.1)
    assert not uncertain(curvature, 1.1 * far).any()
