"""The transfer function of sRGB (IEC 61966-2-1)."""

import numpy as np
import numpy.typing as npt

from engine.model import Float64

Values = npt.NDArray[np.floating]


def to_linear(values: Values) -> Float64:
    """Linear light 0..1 of sRGB values 0..1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def from_linear(light: Values) -> Float64:
    """sRGB values 0..1 of linear light 0..1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-12) ** (1 / 2.4) - 0.055)
