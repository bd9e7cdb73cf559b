"""Attacks on tone and colour: curves of cameras, editors and viewers. Image attacks on values as displayed (sRGB)."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float32
from engine.sim.attack import check_positive
from engine.sim.views.checks import check_image, finished

__all__ = ["VIEWERS", "contrast", "filmic", "gamma", "saturation", "viewer_color", "white_balance"]

LUMA = np.array([0.299, 0.587, 0.114])

# Linear light from Display P3 to sRGB primaries, both D65 (CSS Color 4, sample code).
_P3_TO_SRGB = np.array(
    [
        [1.2249401762805598, -0.22494017628055996, 0.0],
        [-0.042056954709688163, 1.0420569547096881, 0.0],
        [-0.019637554590334432, -0.078636045550631889, 1.0982736001409663],
    ]
)


def gamma(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Every value to the power `strength`: below 1 brighter, above darker."""
    check_image(image)
    return finished(np.clip(image, 0.0, 1.0) ** check_positive(strength, "exponent"))


def filmic(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """ACES's film curve (Narkowicz's fit of 2015) over linear light, exposed `strength` times."""
    check_image(image)
    x = check_positive(strength, "exposure") * to_linear(np.clip(image, 0.0, 1.0))
    return finished(from_linear(np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)))


def contrast(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Distance from mid-grey times `strength`, clipped."""
    check_image(image)
    return finished(0.5 + check_positive(strength, "contrast factor", zero=True) * (image - 0.5))


def saturation(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Distance from the pixel's own grey times `strength`, clipped; 0 is black and white."""
    check_image(image)
    grey = (image @ LUMA)[..., None]
    return finished(grey + check_positive(strength, "saturation factor", zero=True) * (image - grey))


def white_balance(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Red times the root of `strength` and blue divided by it, clipped: above 1 warmer, below cooler."""
    check_image(image)
    tint = np.sqrt(check_positive(strength, "red over blue"))
    return finished(image * np.array([tint, 1.0, 1.0 / tint]))


def viewer_color(image: Float32, strength: str, rng: np.random.Generator) -> Float32:
    """A screenshot from a viewer that manages colour wrongly; `strength` says how (`VIEWERS`)."""
    check_image(image)
    if strength not in VIEWERS:
        raise InputError(f"no viewer mistake is called {strength!r}; there are {', '.join(VIEWERS)}")
    return finished(VIEWERS[strength](np.clip(image, 0.0, 1.0).astype(np.float64)))


def to_linear(values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Linear light 0..1 of sRGB values 0..1 (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def from_linear(light: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """sRGB values 0..1 of linear light 0..1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-12) ** (1 / 2.4) - 0.055)


def _primaries(matrix: npt.NDArray[np.float64]) -> Callable[[npt.NDArray[np.float64]], Any]:
    return lambda values: from_linear(np.clip(to_linear(values) @ matrix.T, 0.0, 1.0))


VIEWERS: dict[str, Callable[[npt.NDArray[np.float64]], Any]] = {
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
