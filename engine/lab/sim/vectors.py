"""Places and directions as arguments."""

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float64


def check_triple(value: npt.ArrayLike, what: str) -> Float64:
    """The value as (3,) float64; InputError naming `what` unless it is three finite numbers."""
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{what} must be three finite numbers, got {value!r}")
    return array
