"""Discs of 2DGS against the slow twin, which solves its authors' plane equations in float64."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.model import Camera, GaussianModel, look_at
from engine.raster import RasterSettings, backward, draw, prepare_view, render, sh_colors
from engine.raster.disc_projection import project_discs
from engine.raster.projection import RECORD, pack_lens
from engine.raster.settings import TILE
from tests.parameters import few
from tests.raster.scenes import TOLERANCE, assert_same_image, camera, random_discs, random_model, relative
from tests.reference import disc_raster as twin

DISCS = random_discs(200, 21, 1)


def assert_same_disc_image(result: np.ndarray, expected: np.ndarray) -> None:
    assert_same_image(result, expected, "most disc pixels")


def colors_for(count: int, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(count).normal(size=(count, channels)).astype(np.float32)


def one_disc(quat: tuple[float, ...], scale: float, mean: tuple[float, ...] = (0.0, 0.0, 2.0)) -> GaussianModel:
    """A half-transparent white disc, turned by `quat` (w, x, y, z); (1, 0, 0, 0) faces the camera."""
    scales = [[np.log(scale), np.log(scale), np.log(scale) - 14.0]]
    return GaussianModel(np.array([mean]), np.array(scales), np.array([quat]), np.zeros(1), np.zeros((1, 1, 3)))


def straight(width: int = 64, height: int = 64, focal: float = 60.0) -> Camera:
    """At the origin, looking along z."""
    return look_at((0, 0, 0), (0, 0, 1), (0, -1, 0), focal, width, height)


@pytest.mark.parametrize(("count", "size"), [(200, (53, 47)), (400, (83, 61)), (60, (17, 16)), (7, (64, 5))])
def test_image(count: int, size: tuple[int, int]) -> None:
    discs, view_from, colors = random_discs(count, count, 1), camera(*size), colors_for(count)
    expected, expected_alpha, _ = twin.rasterize(discs, view_from, colors, background=0.3)
    image, alpha = prepare_view(discs, view_from).render(colors, 0.3)
    assert_same_disc_image(image, expected)
    assert_same_disc_image(alpha, expected_alpha)


def test_a_camera_among_the_discs() -> None:
    """Discs that reach behind the camera are drawn in front of it alone."""
    discs = random_discs(150, 4, 1)
    discs = discs.with_(log_scales=discs.log_scales + np.float32([1.5, 1.5, 1.5]))
    inside = look_at((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), 30.0, 60, 50)
    expected, _, weights = twin.rasterize(discs, inside, colors_for(150))
    homographies = twin.homographies(discs, inside)[:, 2]
    reach = 3.0 * np.hypot(homographies[:, 0], homographies[:, 1])
    crossing = (homographies[:, 3] > 0.01) & (reach > homographies[:, 3])
    assert (weights[crossing].max(axis=(1, 2)) > 0.05).sum() > 5
    assert_same_disc_image(prepare_view(discs, inside).render(colors_for(150))[0], expected)


@pytest.mark.parametrize(
    "settings",
    [
        RasterSettings(near=1.5),
        RasterSettings(by_distance=True),
        RasterSettings(alpha_skip=0.05, transmittance_stop=0.2),
    ],
)
def test_settings(settings: RasterSettings) -> None:
    expected, _, _ = twin.rasterize(DISCS, camera(), colors_for(200), settings)
    assert_same_disc_image(prepare_view(DISCS, camera(), settings).render(colors_for(200))[0], expected)
    assert np.abs(expected - twin.rasterize(DISCS, camera(), colors_for(200))[0]).max() > 0.01


def test_a_disc_in_perspective() -> None:
    """A disc tilted by 60 degrees: its profile along the vertical axis, worked out by hand."""
    tilt, s, depth, focal = np.radians(60.0), 0.5, 2.0, 60.0
    disc = one_disc((np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0), s)
    alpha = prepare_view(disc, straight(65, 65, focal)).render(np.ones((1, 1), np.float32))[1]
    slope = (np.arange(65) + 0.5 - 32.5) / focal  # y / z of the rays through the middle column
    v = depth * slope / (np.cos(tilt) - slope * np.sin(tilt))  # y = v cos, z = depth + v sin: y = slope z
    low_pass = np.exp(-((slope * focal) ** 2))
    expected = 0.5 * np.maximum(np.exp(-0.5 * (v / s) ** 2), low_pass)
    np.testing.assert_allclose(alpha[:, 32], np.where(expected >= 1 / 255, expected, 0), atol=1e-5)
    assert abs(alpha[40, 32] - alpha[24, 32]) > 0.02, "nearer and farther half differ"


def test_low_pass_of_what_is_too_small_or_seen_from_the_edge() -> None:
    y, x = np.mgrid[:64, :64] + 0.5
    expected = 0.5 * np.exp(-((x - 32.0) ** 2 + (y - 32.0) ** 2))
    expected[expected < 1 / 255] = 0.0
    half = np.sqrt(0.5)
    for disc in (one_disc((1, 0, 0, 0), 1e-4), one_disc((half, half, 0, 0), 1e-3), one_disc((half, 0, half, 0), 1e-3)):
        alpha = prepare_view(disc, straight()).render(np.ones((1, 1), np.float32))[1]
        np.testing.assert_allclose(alpha, expected, atol=1e-5)


def test_flat_models_are_drawn_as_discs_without_being_told() -> None:
    view_from = camera()
    position = view_from.position
    colors = sh_colors(DISCS.sh, DISCS.means, position)
    output = prepare_view(DISCS, view_from, RasterSettings(kernel="disc")).render(colors)[0]
    np.testing.assert_array_equal(render(DISCS, view_from), output)
    as_gaussians = render(DISCS, view_from, settings=RasterSettings(kernel="gaussian"))
    assert np.abs(as_gaussians - output).max() > 0.05
    thick = random_model(200, 21, 1)
    assert prepare_view(thick, view_from).geometry.discs.size == 0
    flattened = prepare_view(thick, view_from, RasterSettings(kernel="disc")).render(colors)[0]
    np.testing.assert_array_equal(flattened, output, "the third scale is not looked at")
    with pytest.raises(InputError, match="kernel"):
        RasterSettings(kernel="surfel")


def test_is_flat() -> None:
    assert DISCS.is_flat
    assert not random_model(200, 21, 1).is_flat
    assert not DISCS.take(np.arange(0)).is_flat
    log_scales = DISCS.log_scales.copy()
    log_scales[7, 2] = 1.0  # one row of 200 is half a per cent
    assert DISCS.with_(log_scales=log_scales).is_flat
    log_scales[:7, 2] = 1.0
    assert not DISCS.with_(log_scales=log_scales).is_flat
    needles = DISCS.log_scales.copy()
    needles[:, 1] = needles[:, 2]
    assert not DISCS.with_(log_scales=needles).is_flat


@pytest.mark.parametrize("run", [project_discs, project_discs.py_func], ids=["compiled", "python"])
def test_records(run) -> None:
    """The closed form in a record meets the plane where the twin's two planes do."""
    view_from, n = camera(), len(DISCS)
    records, discs = np.zeros((n + 2) * RECORD, np.float32), np.zeros((n + 2) * RECORD, np.float32)
    depths, index, counts = np.zeros(n, np.float32), np.zeros(n, np.int32), np.zeros(4, np.int64)
    run(
        DISCS.means.ravel(),
        DISCS.quats.ravel(),
        DISCS.log_scales.ravel(),
        DISCS.opacity_logits,
        pack_lens(view_from, RasterSettings()).astype(np.float64),
        50,
        records,
        discs,
        (np.zeros(2 * n, np.float32), np.zeros(4 * n, np.int16), np.ones(n, np.uint16)),
        depths,
        index,
        counts,
    )
    found = np.concatenate([index[50 * part : 50 * part + k] for part, k in enumerate(counts)])
    assert len(found) > 100
    WH = twin.homographies(DISCS, view_from)
    for i in found:
        u0, v0, a, m, b, k0, k1, l = discs[i * RECORD : (i + 1) * RECORD].astype(np.float64)
        x, y = np.array([5.5, 20.5, 40.5]), np.array([30.5, 3.5, 17.5])
        u, v, z = twin.meet(WH[i], x, y)
        p0, p1 = a * (x - u0), m * (x - u0) + b * (y - v0)
        g = 1 - k0 * p0 - k1 * p1
        ahead = (z > 0) & (u * u + v * v < 100)
        np.testing.assert_allclose((p0**2 + p1**2 - (u * u + v * v) * g * g)[ahead], 0.0, atol=2e-3)
        np.testing.assert_allclose((z * g)[ahead], WH[i, 2, 3], rtol=1e-3)
        assert l == pytest.approx(np.log2(DISCS.opacities[i]), abs=1e-5)


@pytest.mark.parametrize("seed", [0, 1])
def test_lists_hold_every_disc_that_shows_and_few_more(seed: int) -> None:
    """Few more, but for discs that reach the camera's plane: those are looked for everywhere."""
    discs, view_from = random_discs(300, seed, 1), camera(83, 61)
    geometry = prepare_view(discs, view_from).geometry
    needed = set()
    for i in range(300):  # alone, so that nothing hides it
        weights = twin.rasterize(discs.take(np.array([i])), view_from, np.ones((1, 1)))[2][0]
        needed |= {
            (int(y) // TILE * geometry.tiles_x + int(x) // TILE, i) for y, x in np.argwhere(weights > 1.0001 / 255)
        }
    listed = {
        (tile, int(i))
        for tile in range(len(geometry.starts) - 1)
        for i in geometry.ids[geometry.starts[tile] : geometry.starts[tile + 1]]
    }
    depth_row = twin.homographies(discs, view_from)[:, 2]
    reach = np.sqrt(2 * np.log(np.maximum(255 * discs.opacities, 1.0)))
    reaches_back = reach * np.hypot(depth_row[:, 0], depth_row[:, 1]) > 0.95 * depth_row[:, 3]
    assert needed <= listed
    bounded = {(tile, i) for tile, i in listed if not reaches_back[i]}
    least = {(tile, i) for tile, i in needed if not reaches_back[i]}
    assert len(least) > 300
    assert len(bounded) <= 1.2 * len(least)


@pytest.mark.parametrize("channels", few([3], [1, 3, 4]))
def test_backward_colors(channels: int) -> None:
    weights = twin.rasterize(DISCS, camera(), colors_for(200))[2]
    cotangent = np.random.default_rng(channels).normal(size=(47, 53, channels)).astype(np.float32)
    result = prepare_view(DISCS, camera()).backward_colors(cotangent)
    expected = np.einsum("nyx,yxc->nc", weights, cotangent)
    assert relative(result, expected) <= 10 * TOLERANCE["typical gradient"]


def test_backward_is_the_adjoint_of_render() -> None:
    discs, view_from = random_discs(3000, 22, 1), camera(301, 203, 300.0)
    view = prepare_view(discs, view_from)
    colors, cotangent = (colors_for(3000), np.random.default_rng(0).normal(size=(203, 301, 3)).astype(np.float32))
    forward = np.vdot(view.render(colors)[0].astype(np.float64), cotangent)
    pulled = np.vdot(view.backward_colors(cotangent).astype(np.float64), colors)
    assert forward == pytest.approx(pulled, rel=1e-5)


def test_weights() -> None:
    weights = twin.rasterize(DISCS, camera(), colors_for(200))[2]
    view = prepare_view(DISCS, camera())
    sum_w, sum_w2 = view.weights()
    close = 10 * TOLERANCE["typical gradient"]
    assert relative(sum_w, weights.sum((1, 2))) <= close
    assert relative(sum_w2, (weights**2).sum((1, 2))) <= close
    pixel_map = np.random.default_rng(0).random((47, 53)).astype(np.float32)
    mapped = view.backward_colors(pixel_map[:, :, None])[:, 0]
    assert relative(mapped, np.einsum("nyx,yx->n", weights, pixel_map)) <= close


def test_geometry_has_no_gradient_and_says_so() -> None:
    rendering = draw(DISCS, camera())
    with pytest.raises(InputError, match="discs"):
        backward(rendering, rendering.image)
