"""Storage in half precision (IEEE 754 binary16): what a viewer's buffers keep of a model."""

import numpy as np

from engine.errors import InputError
from engine.model import ATTRIBUTES, GaussianModel

__all__ = ["half_precision"]

_LARGEST = float(np.finfo(np.float16).max)


def half_precision(model: GaussianModel) -> GaussianModel:
    """Every value rounded to float16 and back, quaternions brought to unit length again.

    No file format read here holds half floats (SPZ and SOG quantise in their own way): this is what happens in graphics
    memory, and in files of viewers that dump it. Centres keep 11 bits, so that a scene far from its origin shows steps.
    InputError if a centre or a coefficient is too large for float16 (65,504).
    """
    for name in ("means", "sh"):
        array = getattr(model, name)
        rows = np.flatnonzero((np.abs(array) > _LARGEST).reshape(len(array), -1).any(axis=1))
        if len(rows):
            raise InputError(f"{name}: row {rows[0]} is too large for float16: {array[rows[0]].tolist()}")
    half = model.with_(**{name: getattr(model, name).astype(np.float16) for name in ATTRIBUTES})
    quats = half.quats.astype(np.float64)
    return half.with_(quats=quats / np.linalg.norm(quats, axis=1, keepdims=True))
