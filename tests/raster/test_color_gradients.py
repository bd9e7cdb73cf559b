"""The colour VJP, the blending weights and the SH kernels."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from engine.errors import InputError
from engine.lab.raster.sh_gradients import sh_colors_backward
from engine.raster import prepare_view, sh_basis, sh_colors
from engine.raster.spherical_harmonics import evaluate
from tests.parameters import few
from tests.raster.scenes import TOLERANCE, camera, random_model, relative
from tests.reference import raster as twin

MODEL = random_model(200, 21, 1)


@pytest.fixture(scope="module")
def weights() -> np.ndarray:
    """(N, H, W) blending weights of the twin."""
    with torch.no_grad():
        return twin.rasterize(twin.parameters(MODEL, camera()), 53, 47)[2].numpy()


@pytest.mark.parametrize("channels", few([1, 3], [1, 2, 3, 4]))
def test_backward_colors(weights: np.ndarray, channels: int) -> None:
    cotangent = np.random.default_rng(channels).normal(size=(47, 53, channels)).astype(np.float32)
    expected = np.einsum("nyx,yxc->nc", weights, cotangent)
    result = prepare_view(MODEL, camera()).backward_colors(cotangent)
    assert result.dtype == np.float32
    assert relative(result, expected) <= TOLERANCE["typical gradient"]


def test_backward_is_the_adjoint_of_render() -> None:
    model, view_from = random_model(3000, 22, 1), camera(301, 203, 300.0)
    view, rng = prepare_view(model, view_from), np.random.default_rng(0)
    colors = rng.normal(size=(3000, 3)).astype(np.float32)
    cotangent = rng.normal(size=(203, 301, 3)).astype(np.float32)
    image, _ = view.render(colors)
    forward = np.vdot(image.astype(np.float64), cotangent)
    backward = np.vdot(view.backward_colors(cotangent).astype(np.float64), colors)
    assert forward == pytest.approx(backward, rel=1e-5)


def test_weights(weights: np.ndarray) -> None:
    view = prepare_view(MODEL, camera())
    sum_w, sum_w2 = view.weights()
    assert relative(sum_w, weights.sum((1, 2))) <= TOLERANCE["typical gradient"]
    assert relative(sum_w2, (weights**2).sum((1, 2))) <= TOLERANCE["typical gradient"]
    unseen = np.setdiff1d(np.arange(200), view.visible)
    assert len(unseen) > 0
    assert (sum_w[unseen] == 0).all()


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize("count", [1, 16, 37])
def test_sh(coefficients: int, count: int) -> None:
    model, position = random_model(count, 5, coefficients), np.array([0.3, -4.0, 1.0])
    d = model.means.astype(np.float64) - position
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    basis = sh_basis(d, model.sh_degree)
    expected = np.maximum(0.0, 0.5 + np.einsum("nk,nkc->nc", basis, model.sh))
    colors = sh_colors(model.sh, model.means, position)
    np.testing.assert_allclose(colors, expected, atol=3e-6)

    cotangent = np.random.default_rng(0).normal(size=(count, 3)).astype(np.float32)
    gradient = basis[:, :, None] * np.where(expected > 0, cotangent, 0.0)[:, None, :]
    np.testing.assert_allclose(sh_colors_backward(cotangent, model.sh, model.means, position), gradient, atol=3e-6)
    out = np.full_like(model.sh, np.nan)
    result = sh_colors_backward(cotangent, model.sh, model.means, position, colors=colors, out=out)
    assert result is out
    np.testing.assert_allclose(out, gradient, atol=3e-6)


def test_sh_of_some_gaussians_only() -> None:
    model = random_model(50, 5, 16)
    wanted = (np.arange(50) % 3 == 0).astype(np.int32)
    every = sh_colors(model.sh, model.means, np.zeros(3))
    some = np.empty((50, 3), np.float32)
    evaluate(model.sh, model.means, np.zeros(3, np.float32), wanted, some)
    np.testing.assert_array_equal(some[wanted == 1], every[wanted == 1])


def test_sh_where_the_camera_stands_in_a_gaussian() -> None:
    model = random_model(1, 5, 16)
    assert np.isfinite(sh_colors(model.sh, model.means, model.means[0])).all()


def test_sh_refuses_wrong_shapes() -> None:
    model = random_model(5, 5, 16)
    with pytest.raises(InputError):
        sh_colors(model.sh[:, :5], model.means, np.zeros(3))
    with pytest.raises(InputError):
        sh_colors(model.sh, model.means[:4], np.zeros(3))
    with pytest.raises(InputError):
        sh_colors_backward(np.zeros((5, 4), np.float32), model.sh, model.means, np.zeros(3))
    with pytest.raises(InputError):
        sh_colors_backward(np.zeros((5, 3), np.float32), model.sh, model.means, np.zeros(3), out=np.zeros((5, 16, 3)))
