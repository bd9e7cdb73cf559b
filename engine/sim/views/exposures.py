"""Attacks by uneven light: rolling exposure, mains flicker and vignette. Image attacks; gains act on the values."""

import numpy as np

from engine.model import Float32, Float64
from engine.sim.attack import check_fraction
from engine.sim.views.checks import check_image, finished

__all__ = ["FLICKER_BANDS", "flicker", "rolling_exposure", "vignette"]

FLICKER_BANDS = 3.3
"""Bands down a picture: lamps pulse 100 times a second, and rows are read within 1/30 s."""


def rolling_exposure(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Exposure that runs while rows are read: gain from 1 - `strength`/2 at the top to 1 + `strength`/2."""
    check_image(image)
    share = check_fraction(strength, "change of the gain", one=True)
    return _rows(image, 1.0 + share * (_heights(image) - 0.5))


def flicker(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Bands of mains flicker: gain 1 +- `strength` in 3.3 waves down the picture, at a random phase."""
    check_image(image)
    share = check_fraction(strength, "depth of the flicker", one=True)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    return _rows(image, 1.0 + share * np.sin(2.0 * np.pi * FLICKER_BANDS * _heights(image) + phase))


def vignette(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Light lost towards the corners by the cosine-fourth law, `strength` of it in the corners themselves."""
    check_image(image)
    lost = check_fraction(strength, "light lost in the corners")
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width] + 0.5
    # (squared distance from the centre, 1 in the corners); cos^4 = (1 + tan^2)^-2
    r2 = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
    slope = 1.0 / np.sqrt(1.0 - lost) - 1.0
    return finished(image * (1.0 + slope * r2)[..., None] ** -2.0)


def _heights(image: Float32) -> Float64:
    """(H,) middle of each row, 0 at the top edge and 1 at the bottom edge."""
    return np.asarray((np.arange(image.shape[0]) + 0.5) / image.shape[0])


def _rows(image: Float32, gain: Float64) -> Float32:
    return finished(image * gain[:, None, None])
