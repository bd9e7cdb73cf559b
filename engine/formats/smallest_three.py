"""Unit quaternions without their largest component, which the three others give: as SOG, SPZ and compressed PLY."""

from typing import Any

import numpy as np
import numpy.typing as npt

OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""The components that are kept, by the index of the largest."""


def take_apart(quats: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[np.intp]]:
    """The three smaller components (N, 3) of quaternions (N, 4) whose largest is positive, and its index (N,)."""
    largest = np.argmax(np.abs(quats), axis=1)
    signs = np.where(np.take_along_axis(quats, largest[:, None], axis=1) < 0, -1.0, 1.0)
    return np.take_along_axis(quats, OTHERS[largest], axis=1) * signs, largest


def put_together(small: npt.NDArray[Any], largest: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Inverse of `take_apart` for unit quaternions, in the precision of the components."""
    quats = np.empty((len(small), 4), small.dtype)
    np.put_along_axis(quats, OTHERS[largest], small, axis=1)
    rest = small.dtype.type(1) - np.einsum("nc,nc->n", small, small)  # (N,)
    quats[np.arange(len(quats)), largest] = np.sqrt(np.maximum(rest, small.dtype.type(0)))
    return quats
