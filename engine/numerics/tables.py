"""Functions given by a table, looked up for whole images: `numpy.interp` searches the table anew for every pixel.
And a search of rising values, for kernels."""

# mypy: allow-untyped-defs

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.model import Float32, Float64


@inlined
def first_at_least(ascending, value):
    """`np.searchsorted` of one number, for which numba compiles ten functions."""
    low, high = 0, len(ascending)
    while low < high:
        middle = (low + high) >> 1
        if ascending[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@parallel_kernel
def _look_up(x, low, high, values, out, call):
    last = values.size - 1
    scale = last / (high - low)
    for j in share_of(x.shape[0], call):
        for i in range(x.shape[1]):
            place = (x[j, i] - low) * scale
            if not place > 0.0:
                out[j, i] = values[0]
            elif place >= last:
                out[j, i] = values[last]
            else:
                k = int(place)
                out[j, i] = values[k] + (place - k) * (values[k + 1] - values[k])


def look_up(image: npt.NDArray[Any], low: float, high: float, values: Float64) -> Float32:
    """(H, W) a function of each pixel of an image (H, W), linear between `values` (K,) that it takes at evenly spaced
    places from `low` to `high`, and constant beyond."""
    out = np.empty(image.shape, dtype=np.float32)
    _look_up(image, low, high, np.ascontiguousarray(values, dtype=np.float64), out)
    return out
