"""The blur of a picture is found from its reference and the picture alone, where there is one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from engine.model import GaussianModel
from engine.pictures.alignment.blur import Blur, find_blur
from engine.pictures.landmarks.keypoints import luma
from engine.raster import render, render_depth
from tests.parameters import few
from tests.pictures.image_cases import attack, marked, picture
from tests.pictures.plant_views import around

SIDE = 500
SOLID = np.ones((SIDE, SIDE), dtype=np.float32)


def line(length: float, degrees: float) -> np.ndarray:
    """(23, 23) weights of a way of `length` pixels, each of its points shared by the four pixels around it."""
    kernel, way = np.zeros((23, 23)), np.linspace(-0.5, 0.5, 400) * length
    x, y = 11 + way * np.cos(np.radians(degrees)), 11 + way * np.sin(np.radians(degrees))
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    for down in (0, 1):
        for right in (0, 1):
            share = np.abs(1 - right - (x - left)) * np.abs(1 - down - (y - top))
            np.add.at(kernel, (top + down, left + right), share)
    return kernel / kernel.sum()


def spot(sigma: float) -> np.ndarray:
    impulse = np.zeros((23, 23))
    impulse[11, 11] = 1.0
    return ndimage.gaussian_filter(impulse, sigma)


def hook() -> np.ndarray:
    """A hand that turns while it moves."""
    kernel = np.zeros((23, 23))
    kernel[11, 5:15] = 1.0
    kernel[11:16, 14] = 1.0
    return ndimage.gaussian_filter(kernel / kernel.sum(), 0.6)


KERNELS = {f"line {length}, {angle}": line(length, angle) for length in (5, 10, 15) for angle in (0, 30, 90, 135)} | {
    "spot 0.7": spot(0.7),
    "spot 1.2": spot(1.2),
    "spot 2": spot(2.0),
    "spot 3": spot(3.0),
    "hook": hook(),
}


def blurred(sharp: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Stored as bytes."""
    shown = np.stack([ndimage.correlate(plane, kernel, mode="reflect") for plane in np.moveaxis(sharp, 2, 0)], axis=2)
    return np.asarray(np.round(np.clip(shown, 0, 1) * 255) / 255, dtype=np.float32)


def kernel_of(blur: Blur) -> np.ndarray:
    """(23, 23)."""
    room = 11 - len(blur.kernel) // 2
    return np.pad(blur.kernel, room) if room >= 0 else blur.kernel[-room:room, -room:room]


def moments(kernel: np.ndarray) -> np.ndarray:
    """(3,) second moments: across, mixed, down."""
    y, x = np.mgrid[-11:12, -11:12].astype(float)
    x, y = x - (kernel * x).sum(), y - (kernel * y).sum()
    return np.array([(kernel * each).sum() for each in (x * x, x * y, y * y)])


def missed(found: Blur, sharp: np.ndarray, true: np.ndarray) -> float:
    """What a render blurred as was found misses the picture by, in parts of what the sharp one does."""
    inner = (slice(16, -16), slice(16, -16))
    exact = luma(blurred(sharp, true))
    off = [float(np.std((luma(each) - exact)[inner])) for each in (found.apply(sharp), sharp)]
    return off[0] / off[1]


@pytest.mark.parametrize(
    "name", few(["spot 0.7", "line 5, 0", "line 10, 135", "line 15, 30", "spot 1.2", "hook"], KERNELS)
)
def test_a_known_blur_is_found(name: str) -> None:
    """Under a gain and an offset, with a mark of 46 dB on the picture, which is noise to it."""
    true, sharp = KERNELS[name], picture(3, SIDE)
    noise = np.kron(np.random.default_rng(1).choice([-1.0, 1.0], (SIDE // 5, SIDE // 5)), np.ones((5, 5)))
    seen = 0.9 * blurred(sharp + 0.005 * noise[..., None].astype(np.float32), true) + 0.05
    found = find_blur(luma(sharp), SOLID, luma(seen))
    assert found is not None
    assert found.kernel.sum() == pytest.approx(1.0, abs=1e-4)
    assert moments(kernel_of(found)) == pytest.approx(moments(true), rel=0.05, abs=0.25)
    assert missed(found, sharp, true) < (0.12 if name == "spot 0.7" else 0.06), "of which the sharp one misses less"


@pytest.mark.parametrize("name", ["none", "jpeg10", "jpeg50", "noise 0.1", "brightness 0.5", "brightness 1.5"])
def test_a_picture_that_is_not_blurred_has_none(name: str) -> None:
    case = marked()
    seen = attack(name, case.image)[0]
    assert find_blur(luma(case.plain), SOLID[: len(seen), : len(seen)], luma(seen)) is None


@pytest.mark.parametrize("azimuth", [180, 225, 270])
def test_a_picture_reduced_from_a_larger_one_has_none(plant: GaussianModel, azimuth: float) -> None:
    """A render of its size looks otherwise, but not as a blur would have it."""
    camera = around(plant, azimuth, 20.0, 1.2, 1.0)
    large = np.clip(render(plant, camera.resized(960, 720)), 0.0, 1.0)
    seen = large.reshape(360, 2, 480, 2, 3).mean(axis=(1, 3))
    image, alpha, _ = render_depth(plant, camera)
    assert find_blur(luma(image), alpha, luma(seen)) is None


def test_the_kernel_of_a_sharp_picture_is_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Most pictures are sharp: they take a first look only."""
    monkeypatch.setattr("engine.pictures.alignment.blur._fit", lambda *_: pytest.fail("was fitted"))
    case = marked()
    assert find_blur(luma(case.plain), SOLID[:300, :300], luma(case.image)) is None


def test_a_blur_far_wider_than_those_that_are_read_is_left() -> None:
    sharp = picture(3, SIDE)
    seen = ndimage.gaussian_filter(luma(sharp), 20.0)
    assert find_blur(luma(sharp), SOLID, seen) is None


def test_a_kernel_that_turns_out_far_wider_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between pictures of two scenes so free a kernel explains much: one, off a screen, was recognized."""
    sharp = luma(picture(3, SIDE))
    monkeypatch.setattr("engine.pictures.alignment.blur._first_look", lambda *_: np.diag([35.0, 1.0]))
    for length, there in ((15, True), (31, False)):
        seen = ndimage.uniform_filter1d(sharp, length, axis=1)
        assert (find_blur(sharp, SOLID, seen) is not None) is there


def test_another_picture_has_none() -> None:
    assert find_blur(luma(picture(3, SIDE)), SOLID, luma(blurred(picture(4, SIDE), spot(2.0)))) is None


def test_too_little_to_tell_gives_none() -> None:
    sharp = luma(picture(3, SIDE))
    seen = luma(blurred(picture(3, SIDE), spot(2.0)))
    assert find_blur(sharp, SOLID, seen) is not None
    few = np.zeros((SIDE, SIDE), dtype=bool)
    few[100:130, 100:130] = True
    assert find_blur(sharp, SOLID, seen, few) is None
    assert find_blur(np.full_like(sharp, 0.5), SOLID, seen) is None
    assert find_blur(sharp[:3, :3], SOLID[:3, :3], seen[:3, :3]) is None


@pytest.mark.parametrize("name", ["line 15, 30", "spot 2"])
def test_what_lies_over_a_part_of_the_picture_leaves_the_kernel_as_it_is(name: str) -> None:
    sharp = picture(3, SIDE)
    seen = blurred(sharp, KERNELS[name])
    seen[200:300, 150:250] = picture(5, SIDE)[:100, :100]
    found = find_blur(luma(sharp), SOLID, luma(seen))
    assert found is not None
    assert missed(found, sharp, KERNELS[name]) < 0.06


@pytest.mark.parametrize("name", ["line 15, 30", "spot 3"])
def test_a_page_behind_the_model_is_blurred_with_it(name: str) -> None:
    y, x = np.mgrid[:SIDE, :SIDE] - SIDE / 2
    alpha = (1.0 / (1.0 + np.exp(np.hypot(x, y) - 180.0))).astype(np.float32)[..., None]
    render = alpha * picture(3, SIDE)
    seen = blurred(render + (1.0 - alpha) * np.float32([0.95, 0.9, 0.8]), KERNELS[name])
    found = find_blur(luma(render), alpha[..., 0], luma(seen))
    assert found is not None
    assert moments(kernel_of(found)) == pytest.approx(moments(KERNELS[name]), rel=0.05, abs=0.25)


def test_a_blur_is_a_weighted_sum_of_what_is_around() -> None:
    kernel = np.random.default_rng(2).uniform(size=(5, 5)).astype(np.float32)
    image = picture(3, 40)
    shown = Blur(kernel).apply(image)
    for row, column in ((2, 2), (20, 31), (37, 37)):
        around = image[row - 2 : row + 3, column - 2 : column + 3]
        assert shown[row, column] == pytest.approx((kernel[..., None] * around).sum(axis=(0, 1)), rel=1e-5)


@pytest.mark.parametrize("size", [5, 19])
def test_the_adjoint_is_that_of_the_blur(size: int) -> None:
    """<blur(a), b> = <a, adjoint(b)>, away from the border."""
    rng = np.random.default_rng(2)
    blur = Blur(rng.uniform(-0.1, 1.0, (size, size)).astype(np.float32))
    a, b = rng.normal(size=(2, 60, 70, 3)).astype(np.float32)
    for each in (a, b):
        each[:20], each[-20:], each[:, :20], each[:, -20:] = 0.0, 0.0, 0.0, 0.0
    forward, back = float((blur.apply(a) * b).sum()), float((a * blur.adjoint(b)).sum())
    assert forward == pytest.approx(back, rel=1e-4)
    assert abs(forward) > 1.0


def test_the_widths_are_those_of_the_kernel() -> None:
    assert Blur(line(15, 30).astype(np.float32)).widths == pytest.approx((15 / np.sqrt(12), 0.4), abs=0.2)
    assert Blur(np.roll(spot(2.0), 3, axis=1).astype(np.float32)).widths == pytest.approx((2.0, 2.0), abs=0.01)
