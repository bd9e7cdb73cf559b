"""Image quality: one PSNR and one SSIM for the whole program. See docs/CONVENTIONS.md."""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.kernels.jit import kernel
from engine.model import Float32

SSIM_RADIUS = 5
"""Half width of the 11-tap window of Wang et al."""
SSIM_SIGMA = 1.5
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2
"""Wang et al., K1 and K2 at a data range of 1."""


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
