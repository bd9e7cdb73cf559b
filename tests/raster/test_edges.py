"""Nothing a reader can produce may crash, hang or make a NaN."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import InputError
from engine.model import Camera, GaussianModel, look_at
from engine.raster import backward, draw, prepare_view, render, render_depth
from engine.raster.forward import blend_tiles, forward_scratch
from engine.raster.settings import MAX_SIGMA_PX
from engine.raster.workspace import borrow_workspace
from tests.raster.scenes import camera, random_discs, random_model


def check(model: GaussianModel, view_from: Camera) -> np.ndarray:
    """Draw and differentiate; everything must come out finite. Returns the image."""
    rendering = draw(model, view_from, 0.25)
    assert np.isfinite(rendering.view.backward_colors(np.ones_like(rendering.image))).all()
    if not model.is_flat:  # discs have gradients of colours alone
        gradients = backward(rendering, np.ones_like(rendering.image), np.ones_like(rendering.alpha))
        for name in ("means", "quats", "log_scales", "opacity_logits", "sh", "colors", "viewmat", "K"):
            assert np.isfinite(getattr(gradients, name)).all(), name
    assert np.isfinite(rendering.image).all()
    assert rendering.alpha.min() >= 0.0
    assert rendering.alpha.max() <= 1.0
    for sums in rendering.view.weights():
        assert np.isfinite(sums).all()
    np.testing.assert_array_equal(render(model, view_from, 0.25), rendering.image)
    return rendering.image


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17, 33])
def test_any_number_of_gaussians(count: int) -> None:
    image = check(random_model(count, 1, 4), camera())
    check(random_discs(count, 1, 4), camera())
    assert count > 0 or (image == 0.25).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (16, 16), (17, 31)])
def test_any_size(size: tuple[int, int]) -> None:
    assert check(random_model(60, 2, 1), camera(*size)).shape == (size[1], size[0], 3)


def test_nothing_in_sight() -> None:
    away = look_at((0.0, 0.0, -50.0), (0.0, 0.0, -100.0), (0.0, -1.0, 0.0), 60.0, 40, 30)
    assert (check(random_model(60, 3, 4), away) == 0.25).all()
    view = prepare_view(random_model(60, 3, 4), away)
    assert len(view.visible) == 0
    assert (view.backward_colors(np.ones((30, 40, 3), np.float32)) == 0).all()
    image, alpha, depth = render_depth(random_model(60, 3, 4), away)
    assert (image == 0).all()
    assert (alpha == 0).all()
    assert (depth == 0).all()


def test_camera_inside() -> None:
    inside = look_at((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), 30.0, 60, 50)
    check(random_model(400, 4, 4), inside)
    check(random_discs(400, 4, 4), inside)


@pytest.mark.parametrize(
    "log_scales",
    [
        (-40.0, -40.0, -40.0),
        (-88.0, -3.0, -3.0),
        (-20.0, -20.0, 2.0),
        (5.0, 5.0, 5.0),
        (40.0, 0.0, -40.0),
        (80.0, 80.0, 80.0),
    ],
)
def test_tiny_huge_and_needle_gaussians(log_scales: tuple[float, float, float]) -> None:
    model = random_model(50, 5, 4)
    alike = np.tile(np.float32(log_scales), (50, 1))
    check(model.with_(log_scales=alike), camera())
    alike[:, 2] = alike[:, :2].min(axis=1) - 12.0
    check(model.with_(log_scales=alike), camera())


def test_wider_than_float32_can_place_is_not_drawn() -> None:
    model = random_model(20, 6, 1)
    wide = model.with_(log_scales=np.full((20, 3), np.log(100 * MAX_SIGMA_PX), np.float32))
    assert (check(wide, camera()) == 0.25).all()


@pytest.mark.parametrize("logit", [-100.0, -5.6, -5.5, 0.0, 30.0, 100.0])
def test_any_opacity(logit: float) -> None:
    model = random_model(50, 7, 1)
    check(model.with_(opacity_logits=np.full(50, logit, np.float32)), camera())


def test_zero_quaternions_and_far_coordinates() -> None:
    model = random_model(50, 8, 4)
    check(model.with_(quats=np.zeros((50, 4), np.float32)), camera())
    check(model.with_(means=model.means * 1e6), camera())
    check(model.with_(means=model.means * 0.0), camera())
    discs = random_discs(50, 8, 4)
    check(discs.with_(quats=np.zeros((50, 4), np.float32)), camera())
    check(discs.with_(means=discs.means * 1e6), camera())
    check(discs.with_(means=discs.means * 0.0), camera())


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    spread=st.floats(0.0, 1e4),
    size=st.floats(-30.0, 12.0),
    anisotropy=st.floats(0.0, 12.0),
    opacity=st.floats(-20.0, 40.0),
    focal=st.floats(1.0, 5000.0),
)
def test_anything(seed: int, spread: float, size: float, anisotropy: float, opacity: float, focal: float) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 40))
    model = GaussianModel(
        (rng.normal(size=(n, 3)) * spread).astype(np.float32),
        (size + anisotropy * rng.normal(size=(n, 3))).astype(np.float32),
        rng.normal(size=(n, 4)).astype(np.float32),
        (opacity + rng.normal(size=n)).astype(np.float32),
        rng.normal(size=(n, 4, 3)).astype(np.float32),
    )
    flat = model.log_scales.copy()
    flat[:, 2] = flat[:, :2].min(axis=1) - 12.0
    check(model.with_(log_scales=flat), look_at((0.1, 0.2, -3.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), focal, 37, 21))
    check(model, look_at((0.1, 0.2, -3.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), focal, 37, 21))


def test_more_pairs_than_memory_are_refused() -> None:
    model = random_model(16, 9, 1)
    with pytest.raises(InputError, match="too large"):
        prepare_view(model, look_at((0, 0, -3), (0, 0, 0), (0, -1, 0), 60.0, 16 * 40000, 16))


@pytest.mark.parametrize(("width", "height"), [(48, 37), (37, 48), (48, 48)])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_nothing_is_written_behind_the_image(width: int, height: int, channels: int) -> None:
    """Tiles at its edges reach over it; those that do not are written as vectors."""
    geometry = prepare_view(random_model(200, 3, 1), camera(width, height)).geometry
    pixels, more = width * height, 16 * width
    image, alpha = np.full((pixels + more) * channels, 7.0, np.float32), np.full(pixels + more, 7.0, np.float32)
    colors, background = np.ones(200 * channels, np.float32), np.zeros(channels, np.float32)
    with borrow_workspace() as work:
        bench, evaluated = work.tile_bench(forward_scratch(channels)), np.zeros(len(geometry.starts) - 1, np.int64)
        out = image[: pixels * channels], alpha[:pixels], evaluated
        blend_tiles(geometry.lists, (0,) * channels, colors, background, *out, bench, None)
    assert (image[pixels * channels :] == 7.0).all()
    assert (alpha[pixels:] == 7.0).all()
    assert (out[1] <= 1.0).all()
