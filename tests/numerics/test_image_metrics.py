"""PSNR against its formula, SSIM against scikit-image, and what neither may be fooled by."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from engine.errors import InputError
from engine.numerics.image_metrics import psnr, ssim


def picture(seed: int, height: int = 48, width: int = 61, channels: int = 3) -> np.ndarray:
    """Smooth waves, a flat bright block and a little grain: flat, edged and textured regions."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    waves = np.stack([np.sin(x / (3 + c) + seed) * np.cos(y / (5 + c)) for c in range(channels)], axis=-1)
    image = 0.5 + 0.3 * waves + 0.02 * rng.standard_normal((height, width, channels))
    image[5:25, 5:25] = 0.97
    return np.clip(image, 0, 1).astype(np.float32)


def skimage_ssim(a: np.ndarray, b: np.ndarray) -> float:
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0}
    axis = 2 if a.ndim == 3 else None
    return float(structural_similarity(a.astype(np.float64), b.astype(np.float64), channel_axis=axis, **options))


@pytest.mark.parametrize("amplitude", [0.1, 0.01, 1e-3])
def test_psnr_of_a_known_error(amplitude: float) -> None:
    a = np.full((20, 30, 3), 0.5, dtype=np.float32)
    checker = np.where(np.indices(a.shape).sum(axis=0) % 2 == 0, amplitude, -amplitude)
    assert psnr(a, a + checker) == pytest.approx(-20 * np.log10(amplitude), abs=1e-3)


def test_psnr_clips_as_a_screen_does() -> None:
    a = picture(0)
    glaring = np.where(a > 0.9, 7.0, a)
    assert psnr(a, glaring) == psnr(a, np.clip(glaring, 0, 1)) > 25
    assert psnr(a, a) == float("inf")


@pytest.mark.parametrize("std", [0.3, 0.05, 0.005, 5e-4])
def test_ssim_is_scikit_images(std: float) -> None:
    a = picture(1)
    noise = std * np.random.default_rng(2).standard_normal(a.shape)
    b = np.clip(a + noise, 0, 1).astype(np.float32)
    assert ssim(a, b) == pytest.approx(skimage_ssim(a, b), abs=2e-6)


def test_ssim_is_scikit_images_in_the_dark_and_the_bright() -> None:
    # Where local variance is far below the squared mean a naive E[x^2] - E[x]^2 in float32 goes wrong.
    for level in (0.02, 0.98):
        a = level + 0.004 * (picture(3) - 0.5)
        b = level + 0.004 * (picture(4) - 0.5)
        assert ssim(a, b) == pytest.approx(skimage_ssim(a, b), abs=2e-6)


def test_ssim_of_unrelated_and_grey_images() -> None:
    a, b = picture(5), picture(6)
    assert ssim(a, b) == pytest.approx(skimage_ssim(a, b), abs=2e-6)
    assert ssim(a[..., 0], b[..., 0]) == pytest.approx(skimage_ssim(a[..., 0], b[..., 0]), abs=2e-6)
    assert ssim(a, a) == pytest.approx(1.0, abs=1e-9)
    assert ssim(a, b) < 0.9


def test_metrics_leave_their_inputs_alone() -> None:
    a, b = picture(7), picture(8)
    before = a.copy(), b.copy()
    psnr(a, b), ssim(a, b)
    np.testing.assert_array_equal(a, before[0])
    np.testing.assert_array_equal(b, before[1])


def test_unfit_images_are_refused() -> None:
    a = picture(9)
    with pytest.raises(InputError, match="shape"):
        psnr(a, a[1:])
    with pytest.raises(InputError, match="uint8"):
        psnr(a, (a * 255).astype(np.uint8))
    with pytest.raises(InputError, match="11x11"):
        ssim(a[:10], a[:10])
    with pytest.raises(InputError, match="shape"):
        psnr(a[:0], a[:0])


def test_ssim_does_not_depend_on_how_pictures_lie_in_memory() -> None:
    rng = np.random.default_rng(4)
    a = rng.random((40, 30, 3), np.float32)
    b = np.clip(a + 0.1 * rng.standard_normal(a.shape).astype(np.float32), 0, 1)
    across = [np.ascontiguousarray(each.transpose(1, 0, 2)).transpose(1, 0, 2) for each in (a, b)]
    assert not across[0].flags.c_contiguous
    assert ssim(*across) == ssim(a, b)
    assert ssim(a[:, ::-1], b[:, ::-1]) == pytest.approx(ssim(a, b), abs=1e-6)
