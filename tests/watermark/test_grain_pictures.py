"""The grain as a picture shows it: how its residual answers to a move of each Gaussian, against renders themselves."""

from __future__ import annotations

import numpy as np
import pytest

from engine.flows.views.camera_rig import make_rig
from engine.model import Camera, GaussianModel
from engine.raster import RasterSettings, draw, prepare_view, render
from engine.watermark.grain import ATTRIBUTES, Grain, roughen, thin
from engine.watermark.grain_pictures import GrainView
from tests.watermark.ball import ball_model

GRAIN = Grain(0.04, 0.02)


@pytest.fixture(scope="module")
def ball() -> GaussianModel:
    model = ball_model(600)
    quats = model.quats / np.linalg.norm(model.quats, axis=1, keepdims=True)
    scales = model.log_scales.copy()
    scales[::7, 1] -= 14.0  # some are discs
    return model.with_(quats=quats.astype(np.float32), log_scales=scales)


@pytest.fixture(scope="module")
def camera(ball: GaussianModel) -> Camera:
    return make_rig(ball, 1, 128, 128)[0]


def test_what_is_pulled_back_is_the_change_of_the_picture(ball: GaussianModel, camera: Camera) -> None:
    """To first order, in the grain's own units, for centres and for sizes."""
    view = GrainView(draw(ball, camera), GRAIN)
    rng = np.random.default_rng(3)
    smooth = np.kron(rng.standard_normal((16, 16, 3)), np.ones((8, 8, 1))).astype(np.float32)
    colors, moved = view.pull(view.rendering.view, smooth)
    np.testing.assert_allclose(colors, view.rendering.view.backward_colors(smooth), atol=1e-3 * np.abs(colors).max())
    for kind, step in (("centres", 2e-3), ("sizes", 2e-3)):
        signs = np.zeros((len(ball), ATTRIBUTES), np.float32)
        columns = slice(0, 3) if kind == "centres" else slice(3, 6)
        signs[:, columns] = 2.0 * (moved.reshape(-1, ATTRIBUTES)[:, columns] > 0) - 1.0  # what raises it most
        if kind == "sizes":
            signs[:, 3:] *= ~thin(ball.log_scales)
        up, down = (render(roughen(ball, Grain(step, step), sign * signs), camera) for sign in (1, -1))
        rise = float(np.vdot(smooth, up - down)) / (2 * step)
        assert rise == pytest.approx(float(moved @ signs.reshape(-1)), rel=0.05), kind


def test_the_filter_weighs_by_amplitude_and_leaves_discs_their_thickness(ball: GaussianModel, camera: Camera) -> None:
    weights = GrainView(draw(ball, camera), GRAIN).weights().reshape(-1, ATTRIBUTES)
    np.testing.assert_allclose(weights[:, :3], GRAIN.center, rtol=1e-6)
    np.testing.assert_array_equal(weights[:, 3:] == 0.0, thin(ball.log_scales))
    assert (weights[:, 3:] == 0.0).any()


def test_colours_come_from_the_view_as_it_was_drawn(ball: GaussianModel, camera: Camera) -> None:
    """The grain's gradient knows no antialiasing; the tint's does."""
    smoothed = prepare_view(ball, camera, RasterSettings(antialiased=True))
    cotangent = np.random.default_rng(4).standard_normal((128, 128, 3)).astype(np.float32)
    colors, _ = GrainView(draw(ball, camera), GRAIN).pull(smoothed, cotangent)
    np.testing.assert_array_equal(colors, smoothed.backward_colors(cotangent))
