"""Purification of pictures: denoisers that take a weak mark for noise.

Image attacks as in `engine.lab.sim.image_attacks`. Regeneration by a variational
auto-encoder or a diffusion model needs trained networks and is not to be had here.
"""

import numpy as np

from engine.errors import InputError
from engine.lab.sim.attack import Attacks
from engine.lab.sim.views.encoders import bytes_of, values_of
from engine.model import Float32

__all__ = ["ATTACKS"]

ATTACKS: Attacks[Float32] = Attacks("image")

BILATERAL_REACH = 3.0
"""Spatial standard deviation of the bilateral filter, pixels."""

PATCH, SEARCH = 7, 21
"""Sides of the patches compared and of the window searched by non-local means, pixels (Buades 2005)."""

WAVELET_LEVELS = 4


@ATTACKS.add("median filter", "side, pixels", 3, (3, 5, 7, 9, 15), "1..31")
def median(image: Float32, strength: int, rng: np.random.Generator) -> Float32:
    """Over a square with an odd side, each channel by itself."""
    import cv2

    if strength % 2 == 0:
        raise InputError(f"side of the median must be odd, from 1 to 31, got {strength}")
    return values_of(cv2.medianBlur(bytes_of(image), strength))


@ATTACKS.add("bilateral filter", "colour std, range 1", 0.1, (0.02, 0.05, 0.1, 0.2, 0.4), "(0, inf)")
def bilateral(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Of 3 pixels (Tomasi and Manduchi 1998)."""
    import cv2

    size = 2 * int(np.ceil(2.0 * BILATERAL_REACH)) + 1
    return np.asarray(cv2.bilateralFilter(np.ascontiguousarray(image), size, strength, BILATERAL_REACH))


@ATTACKS.add("non-local means", "filter strength, grey levels", 5, (2, 3, 5, 10, 20), "(0, inf)")
def denoise_nonlocal(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """In Lab (Buades, Coll and Morel 2005)."""
    import cv2

    return values_of(cv2.fastNlMeansDenoisingColored(bytes_of(image), None, strength, strength, PATCH, SEARCH))


@ATTACKS.add(
    "shrink the details of a wavelet transform", "threshold, range 1", 0.03, (0.005, 0.01, 0.03, 0.1, 0.2), "[0, inf)"
)
def denoise_wavelet(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Soft-threshold the details of four Haar levels at `strength` (std, range 1), on 4 shifts averaged.

    Donoho's shrinkage, cycle-spun (Coifman and Donoho 1995) so that no blocks appear; all channels alike.
    """
    from engine.numerics.wavelet import dwt2, idwt2

    threshold = np.float32(strength)
    total = np.zeros_like(image)
    for shift in ((0, 0), (1, 2), (2, 1), (3, 3)):
        moved = np.roll(image, shift, axis=(0, 1))
        approx, details = dwt2(moved, WAVELET_LEVELS)
        shrunk = [tuple(np.sign(b) * np.maximum(np.abs(b) - threshold, 0) for b in bands) for bands in details]
        total += np.roll(idwt2(approx, shrunk), (-shift[0], -shift[1]), axis=(0, 1))
    return np.asarray(total / np.float32(4.0))
