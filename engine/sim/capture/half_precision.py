"""Storage in half precision (IEEE 754 binary16): what a viewer's buffers keep of a model."""

import numpy as np

from engine.errors import InputError
from engine.model import Float32, GaussianModel

__all__ = ["half_precision"]

_LARGEST = float(np.finfo(np.float16).max)


def half_precision(model: GaussianModel) -> GaussianModel:
    """Every value rounded to float16 and back, quaternions brought to unit length again.

    None of the file formats read here holds half floats (PLY has no such type; SPZ and SOG quantise in their own
    way): this is what happens in graphics memory, and in files of viewers that dump it. Centres keep 11 bits, so
    that a scene far from its origin shows steps; means and scales are those of the whole scene, not of a tile.
    InputError if a centre or a coefficient is too large for float16 (65,504).
    """
    for name in ("means", "sh"):
        array = getattr(model, name)
        rows = np.flatnonzero((np.abs(array) > _LARGEST).reshape(len(array), -1).any(axis=1))
        if len(rows):
            raise InputError(f"{name}: row {rows[0]} is too large for float16: {array[rows[0]].tolist()}")

    def rounded(array: Float32) -> Float32:
        return array.astype(np.float16).astype(np.float32)

    quats = rounded(model.quats).astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    means, log_scales, logits, sh = map(rounded, (model.means, model.log_scales, model.opacity_logits, model.sh))
    return GaussianModel(means, log_scales, quats.astype(np.float32), logits, sh)
