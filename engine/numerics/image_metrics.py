"""Image quality: one PSNR and one SSIM for the whole program. See docs/CONVENTIONS.md."""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.kernels.jit import kernel
from engine.model import Float32

__all__ = ["difference_picture", "ms_ssim_distance", "psnr", "ssim", "ssim_maps"]


SSIM_RADIUS = 5
"""Half width of the 11-tap window of Wang et al."""
SSIM_SIGMA = 1.5
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2
"""Wang et al., K1 and K2 at a data range of 1."""

SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Wang et al. 2003: exponents of the scales, finest first, measured with observers."""

LEAST_SIDE = (2 * SSIM_RADIUS + 1) * 2 ** (len(SCALE_WEIGHTS) - 1)
"""Pixels a side must have for the window to fit at the coarsest scale: 176."""


def psnr(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> float:
    """Peak signal-to-noise ratio over all pixels and channels, dB at a peak of 1; infinity for equal images.

    Of images (H, W, C) or (H, W), nominal range 0 to 1; values outside are clipped first, as a screen does. InputError
    if the shapes differ, an image is empty or does not hold floats.
    """
    x, y = _pair(a, b)
    error = np.subtract(x, y)
    mse = float(np.mean(np.square(error, out=error), dtype=np.float64))
    return float("inf") if mse == 0.0 else float(-10.0 * np.log10(mse))


def ssim(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> float:
    """Mean structural similarity, averaged over channels: 1 for equal images, lower is worse, -1 is the floor.

    Of images (H, W, C) or (H, W) of at least 11 by 11 pixels, clipped as for `psnr`. The same number as scikit-image's
    `structural_similarity` with `gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1`, in a
    part of its time: the window is run as one separable filter over all channels, and the two variances are only
    needed as a sum. InputError if the shapes differ, a side is shorter than the window, or an image does not hold
    floats.

    Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment: from error visibility to structural similarity", IEEE
    TIP 13(4), 2004.
    """
    structure, luminance = ssim_maps(a, b)
    return float(np.mean(structure * luminance, dtype=np.float64))


def ssim_maps(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> tuple[Float32, Float32]:
    """The two factors of `ssim` at every place of its window: contrast times structure, and luminance; (H - 10, W -
    10[, C]) float32 each."""
    import cv2  # a heavy import that only image work pays for

    x, y = _pair(a, b)
    window = 2 * SSIM_RADIUS + 1
    if min(x.shape[:2]) < window:
        size = f"{x.shape[1]}x{x.shape[0]}"
        raise InputError(f"SSIM needs images of at least {window}x{window} pixels, got {size}")
    # Moments about mid-grey: E[x^2] - E[x]^2 would lose half of float32's digits in bright flat regions.
    x -= np.float32(0.5)
    y -= np.float32(0.5)
    window_weights = cv2.getGaussianKernel(window, SSIM_SIGMA)
    inner = slice(SSIM_RADIUS, -SSIM_RADIUS)

    def local_mean(image: Float32) -> Float32:
        mean: Float32 = cv2.sepFilter2D(image, -1, window_weights, window_weights)
        return mean

    # Row by row, whatever the layout of the pictures: of any other, `ravel` is a copy, and what is written is lost.
    square, cross = np.empty(x.shape, np.float32), np.empty(x.shape, np.float32)
    fill_products(x.ravel(), y.ravel(), square.ravel(), cross.ravel())
    # In place: the factors take the room of the means they are made of.
    structure, luminance, square, cross = (local_mean(image) for image in (x, y, square, cross))
    compare_windows(structure.ravel(), luminance.ravel(), square.ravel(), cross.ravel())
    return structure[inner, inner], luminance[inner, inner]


@kernel
def fill_products(x: Any, y: Any, square: Any, cross: Any) -> None:
    """x^2 + y^2 and x y of each value; flat float32 arrays, the last two are written."""
    for i in range(len(x)):
        square[i] = x[i] * x[i] + y[i] * y[i]
        cross[i] = x[i] * y[i]


@kernel
def compare_windows(mean_x: Any, mean_y: Any, square: Any, cross: Any) -> None:
    """Both factors of SSIM, written over the means: of windowed means about mid-grey, of x, y, x^2 + y^2 and x y."""
    c1, c2, half = np.float32(SSIM_C1), np.float32(SSIM_C2), np.float32(0.5)
    for i in range(len(mean_x)):
        product = mean_x[i] * mean_y[i]
        powers = mean_x[i] * mean_x[i] + mean_y[i] * mean_y[i]
        # Back to means about black, where the luminance term is defined:
        total = mean_x[i] + mean_y[i]  # (m_x + 1/2)(m_y + 1/2) = m_x m_y + (m_x + m_y)/2 + 1/4
        double = product + product
        structure = (cross[i] + cross[i] - double + c2) / (square[i] - powers + c2)
        mean_x[i] = structure
        mean_y[i] = (double + total + half + c1) / (powers + total + half + c1)


def difference_picture(a: npt.NDArray[Any], b: npt.NDArray[Any], gain: float = 20.0) -> Float32:
    """`gain * |a - b|` of two images as for `psnr`, clipped to 0..1: what an eye can see of a difference."""
    x, y = _pair(a, b)
    return np.asarray(np.clip(np.abs(x - y) * np.float32(gain), 0.0, 1.0))


def ms_ssim_distance(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> float:
    """1 - MS-SSIM: a perceptual distance that needs no trained network, 0 for equal pictures, 1 for unrelated ones. It
    is not LPIPS.

    Of pictures (H, W, C) or (H, W) of at least 176 x 176 pixels, clipped as for `psnr`. Every scale halves the picture
    by 2 x 2 means; contrast and structure count at all scales, luminance at the coarsest. A scale whose mean is
    negative (structure inverted) counts as 0. InputError if the shapes differ, a side is too short, or a picture does
    not hold floats.

    Wang, Simoncelli, Bovik, "Multiscale structural similarity for image quality assessment", Asilomar 2003.
    """
    if min(a.shape[:2], default=0) < LEAST_SIDE:
        raise InputError(f"MS-SSIM needs pictures of at least {LEAST_SIDE} pixels a side, got {a.shape}")
    similarity = 1.0
    for scale, weight in enumerate(SCALE_WEIGHTS):
        structure, luminance = ssim_maps(a, b)
        last = scale == len(SCALE_WEIGHTS) - 1
        shared = structure * luminance if last else structure
        similarity *= max(float(np.mean(shared, dtype=np.float64)), 0.0) ** weight
        if not last:
            a, b = _halved(a), _halved(b)
    return 1.0 - similarity


def _halved(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Means of 2 x 2 pixels of the clipped picture; an odd last row or column is left out."""
    h, w = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    even = np.clip(image[:h, :w], 0.0, 1.0)
    half = (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) * even.dtype.type(0.25)
    return np.asarray(half)


def _pair(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> tuple[Float32, Float32]:
    """Both images clipped, as fresh float32 arrays that may be written to."""
    if a.shape != b.shape:
        raise InputError(f"images differ in shape: {a.shape} and {b.shape}")
    if a.ndim not in (2, 3) or a.size == 0:
        raise InputError(f"expected an image (H, W) or (H, W, C), got shape {a.shape}")
    if not (np.issubdtype(a.dtype, np.floating) and np.issubdtype(b.dtype, np.floating)):
        raise InputError(f"expected images of floats from 0 to 1, got {a.dtype} and {b.dtype}")
    x, y = (np.clip(v, 0.0, 1.0).astype(np.float32, copy=False) for v in (a, b))
    return x, y
