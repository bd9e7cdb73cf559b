"""How the colors of the model that a picture shows were averaged, from the picture and the reference alone."""

from __future__ import annotations

import numpy as np
import pytest

from engine.flows.views.camera_rig import make_rig
from engine.lab.sim.adversaries.laundering import smooth
from engine.model import Bool, Float32, GaussianModel
from engine.pictures.alignment.color_smoothing import ColorSmoothing, Neighborhoods, find_smoothing
from engine.pictures.alignment.config import CONFIG
from engine.raster import Rendering, draw, render
from tests.pictures.plant_views import jpeg


@pytest.fixture(scope="module")
def model(plant: GaussianModel) -> GaussianModel:
    part = plant.take(np.arange(0, len(plant), 3))
    return part.with_(log_scales=part.log_scales + np.float32(0.25))  # closes the gaps


@pytest.fixture(scope="module")
def drawn(model: GaussianModel) -> Rendering:
    return draw(model, make_rig(model, 2, 320, 320)[1])


def found(drawn: Rendering, picture: Float32, usable: Bool | None = None) -> ColorSmoothing | None:
    plain, colors = np.clip(drawn.image, 0.0, 1.0), drawn.model.sh[:, 0]
    usable = drawn.alpha > CONFIG.smoothing.opaque if usable is None else usable
    return find_smoothing(Neighborhoods(drawn.model.means), colors, drawn.view, plain, picture, usable)


def shown(model: GaussianModel, drawn: Rendering) -> Float32:
    return np.clip(render(model, drawn.view.camera), 0.0, 1.0)


@pytest.mark.parametrize(("neighbors", "quality"), [(8, None), (32, None), (64, None), (32, 30)])
def test_smoothed_colors_are_found_again(drawn: Rendering, neighbors: int, quality: int | None) -> None:
    washed = smooth(drawn.model, neighbors)
    picture = shown(washed, drawn)
    smoothing = found(drawn, picture if quality is None else jpeg(picture, quality))
    assert smoothing is not None
    assert smoothing.kept < 0.2
    original, wanted = drawn.model.sh[:, 0], washed.sh[:, 0]
    off = np.square(smoothing.apply(original) - wanted).mean()
    assert off < 0.1 * np.square(original - wanted).mean()


def test_a_tone_curve_hides_no_smoothing(drawn: Rendering) -> None:
    smoothing = found(drawn, shown(smooth(drawn.model, 32), drawn) ** np.float32(0.8))
    assert smoothing is not None
    assert smoothing.kept < 0.3


def test_other_pictures_show_none(drawn: Rendering) -> None:
    plain, rng = np.clip(drawn.image, 0.0, 1.0), np.random.default_rng(0)
    noisy = np.clip(plain + rng.normal(0.0, 0.05, plain.shape), 0.0, 1.0).astype(np.float32)
    for picture in (plain, jpeg(plain, 10), plain ** np.float32(0.8), noisy, np.zeros_like(plain)):
        assert found(drawn, picture) is None
    few = np.zeros(plain.shape[:2], dtype=bool)
    few[:10, :10] = True
    assert found(drawn, shown(smooth(drawn.model, 32), drawn), few) is None


def test_the_adjoint_is_one(model: GaussianModel) -> None:
    rng = np.random.default_rng(1)
    smoothing = ColorSmoothing(Neighborhoods(model.means), np.array([0.1, 0.5, -0.1, 0.5]))
    a, b = (rng.standard_normal((len(model), 3)).astype(np.float32) for _ in range(2))
    one, other = (
        float(np.vdot(x.astype(np.float64), y)) for x, y in ((smoothing.apply(a), b), (a, smoothing.adjoint(b)))
    )
    assert one == pytest.approx(other, rel=1e-3, abs=1e-2)
    constant = np.ones((len(model), 3), dtype=np.float32)
    np.testing.assert_allclose(smoothing.apply(constant), constant, rtol=1e-5)
