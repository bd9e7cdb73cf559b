"""Images against the slow twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from engine.errors import InputError
from engine.model import Camera, GaussianModel
from engine.raster import EarlyStop, RasterSettings, prepare_view, render, render_depth, sh_colors
from tests.raster.scenes import TOLERANCE, assert_same_image, camera, random_model
from tests.reference import raster as twin


def twin_image(model: GaussianModel, view_from, **options):
    with torch.no_grad():
        image, alpha, _ = twin.rasterize(
            twin.parameters(model, view_from), view_from.width, view_from.height, **options
        )
    return image.numpy(), alpha.numpy()


@pytest.mark.parametrize(
    ("count", "coefficients", "size"), [(200, 16, (53, 47)), (200, 9, (32, 48)), (60, 4, (17, 16)), (7, 1, (64, 5))]
)
def test_render(count: int, coefficients: int, size: tuple[int, int]) -> None:
    model, view_from = random_model(count, count, coefficients), camera(*size)
    expected, alpha = twin_image(model, view_from, background=0.3)
    image = render(model, view_from, 0.3)
    assert image.dtype == np.float32
    assert_same_image(image, expected)
    view = prepare_view(model, view_from)
    again, seen_alpha = view.render(sh_colors(model.sh, model.means, view_from.position), 0.3)
    np.testing.assert_array_equal(again, image)
    assert_same_image(seen_alpha, alpha)


def test_skewed_pixels() -> None:
    model, upright = random_model(200, 3, 9), camera()
    K = upright.K.copy()
    K[0] += (7.0, 15.0, -4.0)
    skewed = Camera(upright.viewmat, K, upright.width, upright.height)
    assert_same_image(render(model, skewed), twin_image(model, skewed)[0])


def test_pixels_end() -> None:
    rng = np.random.default_rng(0)
    model = random_model(400, 8, 1).with_(opacity_logits=rng.normal(6.0, 2.0, 400).astype(np.float32))
    expected, alpha = twin_image(model, camera())
    assert alpha.max() > 0.999
    assert_same_image(render(model, camera()), expected)


@pytest.mark.parametrize("tau", [0.3, 0.95, 1.2])
def test_pixels_end_by_impact(tau: float) -> None:
    """Eq 8, also above 1: alphas are summed without the transmittance."""
    rng = np.random.default_rng(1)
    model = random_model(400, 8, 1).with_(opacity_logits=rng.normal(0.5, 1.0, 400).astype(np.float32))
    weights = rng.random(400).astype(np.float32)
    expected, alpha = twin_image(model, camera(), background=0.3, early=(weights, tau))
    view = prepare_view(model, camera())
    colors = sh_colors(model.sh, model.means, camera().position)
    image, seen = view.render(colors, 0.3, EarlyStop(weights, tau))
    assert_same_image(image, expected)
    assert_same_image(seen, alpha)
    whole = view.render(colors, 0.3)[0]
    assert (np.abs(image - whole).max(axis=2) > 0.01).mean() > 0.05, "the stop ends nothing here"
    np.testing.assert_array_equal(view.render(colors, 0.3, EarlyStop(weights, 1e6))[0], whole)


def test_an_early_stop_is_refused_where_it_fits_nothing() -> None:
    view = prepare_view(random_model(20, 1, 1), camera())
    with pytest.raises(InputError, match="tau of the early stop is 0"):
        EarlyStop(np.ones(20, np.float32), 0.0)
    for channels, count in ((3, 19), (1, 20)):
        with pytest.raises(InputError, match="an early stop takes colors"):
            view.render(np.ones((20, channels), np.float32), early=EarlyStop(np.ones(count, np.float32)))


@pytest.mark.parametrize(
    "settings",
    [
        RasterSettings(eps2d=0.0),
        RasterSettings(eps2d=1.5, near=1.5),
        RasterSettings(alpha_clamp=0.5),
        RasterSettings(antialiased=True),
        RasterSettings(by_distance=True),
        RasterSettings(alpha_skip=0.05, transmittance_stop=0.2),
    ],
)
def test_settings(settings: RasterSettings) -> None:
    model = random_model(150, 5, 4)
    expected, _ = twin_image(model, camera(), settings=settings)
    assert_same_image(render(model, camera(), settings=settings), expected)
    if settings.eps2d or settings.antialiased or settings.by_distance:
        assert np.abs(expected - twin_image(model, camera())[0]).max() > 0.01


def test_a_model_says_how_it_is_drawn() -> None:
    plain = random_model(150, 5, 4)
    tagged, view_from = replace(plain, antialiased=True), camera()
    drawn = render(plain, view_from, settings=RasterSettings(antialiased=True))
    np.testing.assert_array_equal(render(tagged, view_from), drawn)
    np.testing.assert_array_equal(render(tagged.take(np.arange(150)), view_from), drawn)
    as_before = render(tagged, view_from, settings=RasterSettings(antialiased=False))
    np.testing.assert_array_equal(as_before, render(plain, view_from))
    assert np.abs(drawn - as_before).max() > 0.01


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_one_to_four_channels(channels: int) -> None:
    model = random_model(120, 7, 1)
    colors = np.random.default_rng(channels).normal(size=(120, channels)).astype(np.float32)
    background = np.linspace(-1.0, 1.0, channels)
    view = prepare_view(model, camera())
    image, alpha = view.render(colors, background)
    expected, expected_alpha = twin_image(
        model, camera(), colors=torch.tensor(colors, dtype=torch.float64), background=torch.tensor(background)
    )
    assert_same_image(image, expected)
    assert_same_image(alpha, expected_alpha)


def test_depth() -> None:
    model = random_model(120, 9, 4)
    image, alpha, depth = render_depth(model, camera(), 0.2)
    np.testing.assert_array_equal(image, render(model, camera(), 0.2))
    row = camera().viewmat[2]
    z = torch.tensor((model.means @ row[:3] + row[3])[:, None], dtype=torch.float64)
    weighted, expected_alpha = twin_image(model, camera(), colors=z)
    assert_same_image(alpha, expected_alpha)
    solid = expected_alpha > 0.1
    error = np.abs(depth - weighted[..., 0] / np.maximum(expected_alpha, 1e-9))[solid]
    assert error.max() <= 10 * TOLERANCE["pixel"]
    assert (depth[expected_alpha == 0] == 0).all()


def test_wrong_shapes_are_refused() -> None:
    model = random_model(20, 0, 1)
    view = prepare_view(model, camera())
    with pytest.raises(InputError, match="colors"):
        view.render(np.zeros((19, 3), np.float32))
    with pytest.raises(InputError, match="background"):
        view.render(np.zeros((20, 3), np.float32), (0.0, 1.0))
    with pytest.raises(InputError, match="background"):
        render(model, camera(), (0.0, 1.0))
    with pytest.raises(InputError, match="cotangent"):
        view.backward_colors(np.zeros((53, 47, 3), np.float32))


@pytest.mark.parametrize(
    "bad", [{"eps2d": -1.0}, {"near": 0.0}, {"alpha_clamp": 1.0}, {"alpha_skip": 0.0}, {"transmittance_stop": 0.0}]
)
def test_settings_are_checked(bad: dict[str, float]) -> None:
    with pytest.raises(InputError):
        RasterSettings(**bad)
