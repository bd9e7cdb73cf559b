"""Attacks on light, tone and colour: uneven light, curves of cameras, editors and viewers.

Image attacks as in `engine.lab.sim.image_attacks`, on values as displayed (sRGB).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.attack import Attacks
from engine.model import Float32, Float64

__all__ = ["ATTACKS"]

ATTACKS: Attacks[Float32] = Attacks("image")

Values = npt.NDArray[Any]

FLICKER_BANDS = 3.3
"""Bands down a picture: lamps pulse 100 times a second, and rows are read within 1/30 s."""

LUMA = np.array([0.299, 0.587, 0.114])

# Linear light from Display P3 to sRGB primaries, both D65 (CSS Color 4, sample code).
_P3_TO_SRGB = np.array(
    [
        [1.2249401762805598, -0.22494017628055996, 0.0],
        [-0.042056954709688163, 1.0420569547096881, 0.0],
        [-0.019637554590334432, -0.078636045550631889, 1.0982736001409663],
    ]
)


@ATTACKS.add(
    "a gain that changes from the first row to the last",
    "change of the gain",
    0.3,
    (0.05, 0.1, 0.2, 0.3, 0.5, 0.8),
    "[0, 1]",
)
def rolling_exposure(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """Exposure that runs while rows are read: gain from 1 - `strength`/2 at the top to 1 + `strength`/2."""
    return image * (1.0 + strength * (_heights(image) - 0.5))


@ATTACKS.add("bands of mains flicker", "depth of the bands", 0.1, (0.02, 0.05, 0.1, 0.2, 0.4), "[0, 1]")
def flicker(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """Gain 1 +- `strength` in 3.3 waves down the picture, at a random phase."""
    phase = rng.uniform(0.0, 2.0 * np.pi)
    return image * (1.0 + strength * np.sin(2.0 * np.pi * FLICKER_BANDS * _heights(image) + phase))


@ATTACKS.add(
    "light lost towards the corners", "share lost in the corners", 0.3, (0.05, 0.1, 0.2, 0.3, 0.5, 0.7), "[0, 1)"
)
def vignette(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """By the cosine-fourth law."""
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width] + 0.5
    # (squared distance from the centre, 1 in the corners); cos^4 = (1 + tan^2)^-2
    r2 = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
    slope = 1.0 / np.sqrt(1.0 - strength) - 1.0
    return np.asarray(image * (1.0 + slope * r2)[..., None] ** -2.0)


@ATTACKS.add(
    "every value to a power", "exponent", 2.2, (0.9, 1.1, 0.8, 1.25, 0.6, 1.6, 0.4545, 2.2, 0.33, 3.0), "(0, inf)"
)
def gamma(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """Below 1 brighter, above darker."""
    return np.asarray(np.clip(image, 0.0, 1.0) ** strength)


@ATTACKS.add("the film curve of ACES over linear light", "exposure", 1.0, (0.6, 0.8, 1.0, 1.5, 2.5, 4.0), "(0, inf)")
def filmic(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """Narkowicz's fit of 2015."""
    x = strength * to_linear(np.clip(image, 0.0, 1.0))
    return from_linear(np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0))


@ATTACKS.add(
    "distance from mid-grey multiplied, clipped",
    "factor",
    1.3,
    (0.95, 1.05, 0.8, 1.2, 1.3, 0.5, 1.6, 0.3, 2.5),
    "[0, inf)",
)
def contrast(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    return np.asarray(0.5 + strength * (image - 0.5))


@ATTACKS.add(
    "distance from the pixel's grey multiplied, clipped",
    "factor",
    1.5,
    (0.9, 1.1, 0.7, 1.5, 0.3, 2.0, 0.0, 3.0),
    "[0, inf)",
)
def saturation(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """0 is black and white."""
    grey = (image @ LUMA)[..., None]
    return np.asarray(grey + strength * (image - grey))


@ATTACKS.add("warmer or cooler light", "red over blue", 1.3, (0.95, 1.05, 0.8, 1.3, 0.6, 1.7, 0.4, 2.5), "(0, inf)")
def white_balance(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """Red times the root of `strength` and blue divided by it: above 1 warmer, below cooler."""
    tint = np.sqrt(strength)
    return np.asarray(image * np.array([tint, 1.0, 1.0 / tint]))


def to_linear(values: Values) -> Float64:
    """Linear light 0..1 of sRGB values 0..1 (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def from_linear(light: Values) -> Float64:
    """sRGB values 0..1 of linear light 0..1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-12) ** (1 / 2.4) - 0.055)


def _primaries(matrix: Float64) -> Callable[[Float64], Float64]:
    return lambda values: from_linear(np.clip(to_linear(values) @ matrix.T, 0.0, 1.0))


VIEWERS: dict[str, Callable[[Float64], Float64]] = {
    # Numbers for an sRGB screen, kept by a P3 screenshot without its profile: pale.
    "p3_as_srgb": _primaries(np.linalg.inv(_P3_TO_SRGB)),
    # sRGB numbers taken for P3 and brought to sRGB: gaudy, with clipped primaries.
    "srgb_as_p3": _primaries(_P3_TO_SRGB),
    # Decoded for blending and never encoded again: dark.
    "srgb_missing": to_linear,
    # Encoded by the shader and once more by the frame buffer: washed out.
    "srgb_twice": from_linear,
}
"""What web viewers do wrong, by name, mildest first."""


@ATTACKS.add("a screenshot from a viewer that manages colour wrongly", "mistake", "srgb_twice", tuple(VIEWERS))
def viewer_color(image: Float32, strength: str, rng: np.random.Generator) -> Values:
    if strength not in VIEWERS:
        raise InputError(f"no viewer mistake is called {strength!r}; there are {', '.join(VIEWERS)}")
    return VIEWERS[strength](np.clip(image, 0.0, 1.0).astype(np.float64))


def _heights(image: Float32) -> Float64:
    """(H, 1, 1) middle of each row, 0 at the top edge and 1 at the bottom edge."""
    return np.asarray((np.arange(image.shape[0]) + 0.5) / image.shape[0])[:, None, None]
