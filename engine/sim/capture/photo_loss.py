"""How far a render is from a photo, with the gradient: (1 - w) L1 + w (1 - SSIM) (Kerbl et al. 2023, Eq 7)."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.errors import InputError
from engine.model import Float32
from engine.numerics.image_metrics import SSIM_C1, SSIM_C2, SSIM_RADIUS, SSIM_SIGMA

__all__ = ["photo_loss"]


def photo_loss(image: Float32, photo: Float32, ssim_weight: float = 0.2) -> tuple[float, Float32]:
    """Loss of a render against a photo, and its gradient with respect to the render.

    SSIM is `engine.numerics.image_metrics.ssim`: the mean over all windows that lie inside the image. Nothing
    is clipped here: a render above 1 is pulled back.

    Parameters
    ----------
    image, photo : (H, W, 3) float32
        At least 11 by 11 pixels when SSIM counts; nominal range 0 to 1.
    ssim_weight : float
        w, from 0 (L1 alone) to 1.

    Returns
    -------
    loss : float
    gradient : (H, W, 3) float32

    Raises
    ------
    InputError
        If the shapes differ, a side is shorter than the window, or the weight lies outside 0..1.
    """
    if image.shape != photo.shape or image.ndim != 3:
        raise InputError(f"render and photo must both be (H, W, C), got {image.shape} and {photo.shape}")
    if not 0.0 <= ssim_weight <= 1.0:
        raise InputError(f"ssim_weight is {ssim_weight}, expected 0 to 1")
    difference = image - photo
    loss = (1.0 - ssim_weight) * float(np.mean(np.abs(difference), dtype=np.float64))
    gradient = np.sign(difference)
    gradient *= np.float32((1.0 - ssim_weight) / image.size)
    if ssim_weight > 0.0:
        similarity, slope = _ssim(image, photo)
        loss += ssim_weight * (1.0 - similarity)
        slope *= np.float32(ssim_weight)
        gradient -= slope
    return loss, gradient


def _ssim(x: Float32, y: Float32) -> tuple[float, Float32]:
    """Mean SSIM and its gradient with respect to x.

    With m = mean, q = E[x^2 + y^2], c = E[xy] of a window (k its weights), SSIM = A B is a function of m_x, q
    and c, so dSSIM/dx(p) = sum over windows of k (d/dm_x + 2 x d/dq + y d/dc).
    """
    import cv2  # a heavy import that only image work pays for

    window, r = 2 * SSIM_RADIUS + 1, SSIM_RADIUS
    if min(x.shape[:2]) < window:
        raise InputError(
            f"SSIM needs images of at least {window}x{window} pixels, got {x.shape[1]}x{x.shape[0]}"
        )
    kernel = cv2.getGaussianKernel(window, SSIM_SIGMA).astype(np.float32)
    half, two = np.float32(0.5), np.float32(2.0)
    c1, c2 = np.float32(SSIM_C1), np.float32(SSIM_C2)

    def local_mean(image: Float32) -> Any:
        return cv2.sepFilter2D(image, -1, kernel, kernel)[r:-r, r:-r]

    # Moments about mid-grey, as the metric takes them: float32 would lose digits in bright flat regions.
    x, y = x - half, y - half
    mean_x, mean_y = local_mean(x), local_mean(y)
    square, cross = local_mean(x * x + y * y), local_mean(x * y)
    product, powers = mean_x * mean_y, mean_x * mean_x + mean_y * mean_y
    covariance, variances = two * (cross - product) + c2, square - powers + c2
    total = mean_x + mean_y
    grey = np.float32(0.5)
    upper, lower = two * product + total + (grey + c1), powers + total + (grey + c1)
    structure, luminance = covariance / variances, upper / lower
    similarity = float(np.mean(structure * luminance, dtype=np.float64))

    scale = np.float32(1.0 / mean_x.size)
    of_structure, of_luminance = luminance / variances * scale, structure / lower * scale
    by_cross = two * of_structure
    by_square = -of_structure * structure
    by_mean = (
        (two * mean_y + 1) * of_luminance - (two * mean_x + 1) * luminance * of_luminance
        - by_cross * mean_y - two * by_square * mean_x
    )  # fmt: skip

    def spread(windows: Float32) -> Any:
        """The adjoint of `local_mean`: nothing comes from outside the windows."""
        padded = np.zeros(x.shape, dtype=np.float32)
        padded[r:-r, r:-r] = windows
        return cv2.sepFilter2D(padded, -1, kernel, kernel, borderType=cv2.BORDER_CONSTANT)

    return similarity, spread(by_mean) + two * x * spread(by_square) + y * spread(by_cross)
