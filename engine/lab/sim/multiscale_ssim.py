"""A perceptual distance of pictures without a trained network."""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.numerics.image_metrics import SSIM_RADIUS, ssim_maps

__all__ = ["ms_ssim_distance"]

SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Wang et al. 2003: exponents of the scales, finest first, measured with observers."""

LEAST_SIDE = (2 * SSIM_RADIUS + 1) * 2 ** (len(SCALE_WEIGHTS) - 1)
"""Pixels a side must have for the window to fit at the coarsest scale: 176."""


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
