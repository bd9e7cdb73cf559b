"""Order along a space-filling curve, for formats that store neighbours together."""

import numpy as np
import numpy.typing as npt

from engine.model import Float32

_BITS = 21
_SPREAD = (  # (shift, mask): moves the bits of a 21-bit number three places apart
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def morton_order(means: Float32) -> npt.NDArray[np.int64]:
    """(N,) int64 indices that sort finite points (N, 3) along the Morton (Z) curve of their bounding box, ties in the
    order given.

    With 2^21 cells an axis, stray points far away still leave the rest of the scene fine cells.
    """
    low = means.min(axis=0).astype(np.float64)
    extent = means.max(axis=0) - low
    scale = (2**_BITS - 1) / np.where(extent > 0, extent, 1.0)
    code = np.zeros(len(means), dtype=np.uint64)
    for axis in range(3):
        bits = ((means[:, axis] - low[axis]) * scale[axis]).astype(np.uint64)
        for shift, mask in _SPREAD:
            bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
        code |= bits << np.uint64(axis)
    return np.argsort(code, kind="stable")
