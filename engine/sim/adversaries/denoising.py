"""Purification of pictures: denoisers that take a weak mark for noise.

All are pure functions `(image, strength, rng) -> image` on float32 (H, W, 3) in 0..1. Regeneration by a variational
auto-encoder or a diffusion model needs trained networks and is not to be had here.
"""

import numpy as np

from engine.errors import InputError
from engine.model import Float32
from engine.sim.attack import check_positive
from engine.sim.views.checks import bytes_of, check_image, finished

__all__ = ["bilateral", "denoise_nonlocal", "denoise_wavelet", "median"]

BILATERAL_REACH = 3.0
"""Spatial standard deviation of the bilateral filter, pixels."""

PATCH, SEARCH = 7, 21
"""Sides of the patches compared and of the window searched by non-local means, pixels (Buades 2005)."""

WAVELET_LEVELS = 4


def median(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Median over a square of `strength` pixels a side, an odd number from 1 to 31, each channel by itself."""
    import cv2

    check_image(image)
    if strength not in range(1, 32, 2):
        raise InputError(f"side of the median must be odd, from 1 to 31, got {strength}")
    levels = cv2.medianBlur(bytes_of(image), int(strength))
    return finished(levels.astype(np.float32) / np.float32(255.0))


def bilateral(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Bilateral filter of 3 pixels and `strength` (std, range 1) in colour (Tomasi and Manduchi 1998)."""
    import cv2

    check_image(image)
    sigma = check_positive(strength, "colour std")
    size = 2 * int(np.ceil(2.0 * BILATERAL_REACH)) + 1
    return finished(cv2.bilateralFilter(np.ascontiguousarray(image), size, sigma, BILATERAL_REACH))


def denoise_nonlocal(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Non-local means in Lab with filter strength h = `strength` grey levels (Buades, Coll and Morel 2005)."""
    import cv2

    check_image(image)
    h = check_positive(strength, "filter strength")
    levels = cv2.fastNlMeansDenoisingColored(bytes_of(image), None, h, h, PATCH, SEARCH)
    return finished(levels.astype(np.float32) / np.float32(255.0))


def denoise_wavelet(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Soft-threshold the details of four Haar levels at `strength` (std, range 1), on 4 shifts averaged.

    Donoho's shrinkage, cycle-spun (Coifman and Donoho 1995) so that no blocks appear; all channels alike.
    """
    from engine.numerics.wavelet import dwt2, idwt2

    check_image(image)
    threshold = np.float32(check_positive(strength, "threshold", zero=True))
    total = np.zeros_like(image)
    for shift in ((0, 0), (1, 2), (2, 1), (3, 3)):
        moved = np.roll(image, shift, axis=(0, 1))
        approx, details = dwt2(moved, WAVELET_LEVELS)
        shrunk = [tuple(np.sign(b) * np.maximum(np.abs(b) - threshold, 0) for b in bands) for bands in details]
        total += np.roll(idwt2(approx, shrunk), (-shift[0], -shift[1]), axis=(0, 1))
    return finished(total / np.float32(4.0))
