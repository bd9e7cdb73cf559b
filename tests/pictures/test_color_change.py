"""How the colors of the model that a picture shows were averaged, from the picture and the reference alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.lab.evaluate.bench.removal import own_cells, wash
from engine.lab.sim.adversaries.laundering import smooth
from engine.model import Bool, Float32, GaussianModel
from engine.pictures.alignment.color_change import (
    Alike,
    ColorChange,
    ColorSmoothing,
    Denoising,
    Misfit,
    Neighborhoods,
    find_color_change,
)
from engine.pictures.alignment.config import CONFIG
from engine.raster import Rendering, draw, render
from engine.watermark.unpredictability import public_misfit
from tests.pictures.plant_views import jpeg

SIZE = 0.02  # of a mark, DC


@pytest.fixture(scope="module")
def model(plant: GaussianModel) -> GaussianModel:
    part = plant.take(np.arange(0, len(plant), 3))
    return part.with_(log_scales=part.log_scales + np.float32(0.25))  # closes the gaps


@pytest.fixture(scope="module")
def drawn(model: GaussianModel) -> Rendering:
    return draw(model, make_rig(model, 2, 320, 320)[1])


def found(drawn: Rendering, picture: Float32, usable: Bool | None = None) -> ColorChange | None:
    plain, colors = np.clip(drawn.image, 0.0, 1.0), drawn.model.sh[:, 0]
    usable = drawn.alpha > CONFIG.color_change.opaque if usable is None else usable
    seen = (colors, drawn.view, plain, picture, usable)
    near = Neighborhoods(drawn.model.means), Alike(drawn.model.means, colors)
    return find_color_change(*near, lambda: misfit(drawn.model), *seen)


def misfit(model: GaussianModel) -> Misfit:
    return Misfit(public_misfit(model, measure_extent(model).radius), SIZE)


def shown(model: GaussianModel, drawn: Rendering) -> Float32:
    return np.clip(render(model, drawn.view.camera), 0.0, 1.0)


@pytest.mark.parametrize(("neighbors", "quality"), [(8, None), (32, None), (64, None), (32, 30)])
def test_smoothed_colors_are_found_again(drawn: Rendering, neighbors: int, quality: int | None) -> None:
    washed = smooth(drawn.model, neighbors)
    picture = shown(washed, drawn)
    smoothing = found(drawn, picture if quality is None else jpeg(picture, quality))
    assert isinstance(smoothing, ColorSmoothing)
    assert smoothing.kept < 0.2
    original, wanted = drawn.model.sh[:, 0], washed.sh[:, 0]
    off = np.square(smoothing.apply(original) - wanted).mean()
    assert off < 0.1 * np.square(original - wanted).mean()


@pytest.mark.parametrize("count", [1400, 700])
def test_means_of_unknown_cells_are_explained_by_neighbors_of_like_color(model: GaussianModel, count: int) -> None:
    drawn = draw(model, make_rig(model, 2, 320, 320)[0])
    washed = own_cells(model, count, 1)
    smoothing = found(drawn, shown(washed, drawn))
    assert isinstance(smoothing, ColorSmoothing)
    assert isinstance(smoothing.neighborhoods, Alike)
    original, wanted = drawn.model.sh[:, 0], washed.sh[:, 0]
    off = np.square(smoothing.apply(original) - wanted).mean()
    assert off < 0.6 * np.square(original - wanted).mean()


def test_large_models_are_not_compared_with_means_of_like_colors(
    model: GaussianModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = replace(CONFIG.color_change, most_alike=len(model) - 1)
    monkeypatch.setattr("engine.pictures.alignment.color_change._CONFIG", few)
    drawn = draw(model, make_rig(model, 2, 320, 320)[0])
    change = found(drawn, shown(own_cells(model, 700, 1), drawn))
    assert not isinstance(change, ColorSmoothing) or not isinstance(change.neighborhoods, Alike)


def test_means_of_like_colors_have_their_adjoint(model: GaussianModel) -> None:
    rng, alike = np.random.default_rng(1), Alike(model.means, model.sh[:, 0])
    x, y = (rng.standard_normal((len(model), 3)).astype(np.float32) for _ in range(2))
    for there, back in zip(alike.averaged(x), alike.adjoint(y), strict=True):
        assert float((there * y).sum()) == pytest.approx(float((x * back).sum()), rel=1e-3, abs=0.1)
    assert all(np.allclose(each, 1.0, atol=1e-4) for each in alike.averaged(np.ones_like(x)))


def test_a_tone_curve_hides_no_smoothing(drawn: Rendering) -> None:
    smoothing = found(drawn, shown(smooth(drawn.model, 32), drawn) ** np.float32(0.8))
    assert isinstance(smoothing, ColorSmoothing)
    assert smoothing.kept < 0.3


def test_denoised_colors_are_found_again(drawn: Rendering) -> None:
    washed = wash(drawn.model, 8.0, SIZE)
    denoising = found(drawn, shown(washed, drawn))
    assert isinstance(denoising, Denoising)
    original, wanted = drawn.model.sh[:, 0], washed.sh[:, 0]
    off = np.square(denoising.shown(original) - wanted).mean()
    assert off < 0.3 * np.square(original - wanted).mean()


def test_the_slope_of_a_limited_misfit_is_its_derivative(model: GaussianModel) -> None:
    values = misfit(model).values[:2_000].astype(np.float64)
    step = 1e-4 * SIZE
    for limit in CONFIG.color_change.limits:
        above, below = (Misfit(values + side * step, SIZE).limited(limit) for side in (1, -1))
        slope = Misfit(values, SIZE).slope(limit)
        np.testing.assert_allclose((above - below) / (2 * step), slope, atol=1e-5)


def test_other_pictures_show_none(drawn: Rendering) -> None:
    plain, rng = np.clip(drawn.image, 0.0, 1.0), np.random.default_rng(0)
    noisy = np.clip(plain + rng.normal(0.0, 0.05, plain.shape), 0.0, 1.0).astype(np.float32)
    for picture in (plain, jpeg(plain, 10), plain ** np.float32(0.8), noisy, np.zeros_like(plain)):
        assert found(drawn, picture) is None
    few = np.zeros(plain.shape[:2], dtype=bool)
    few[:10, :10] = True
    assert found(drawn, shown(smooth(drawn.model, 32), drawn), few) is None


@pytest.mark.parametrize("kind", ["smoothing", "denoising"])
def test_the_adjoint_is_one_and_a_common_shift_comes_through(model: GaussianModel, kind: str) -> None:
    rng, around = np.random.default_rng(1), Neighborhoods(model.means)
    change: ColorChange = ColorSmoothing(around, np.array([0.1, 0.5, -0.1, 0.5]))
    if kind == "denoising":
        change = Denoising(misfit(model), np.array([-1.0, 0.5, -2.0, 0.3, 0.1]), around)
    a, b = (rng.standard_normal((len(model), 3)).astype(np.float32) for _ in range(2))
    pairs = ((change.apply(a), b), (a, change.adjoint(b)))
    one, other = (float(np.vdot(x.astype(np.float64), y)) for x, y in pairs)
    assert one == pytest.approx(other, rel=1e-3, abs=1e-2)
    constant = np.ones((len(model), 3), dtype=np.float32)
    np.testing.assert_allclose(change.apply(constant), constant, rtol=1e-4)
