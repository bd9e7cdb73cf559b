"""The transform of JPEG's blocks: the orthonormal DCT-II of 8x8 pixels (ITU-T T.81, A.3.3), and back."""

# mypy: allow-untyped-defs

import numpy as np
import numpy.typing as npt

from engine.model import Float64
from engine.numerics.jit import inlined, parallel_kernel, share_of

__all__ = ["inverse_transform", "transform"]

_WAVES = np.sqrt((1 + (np.arange(8) > 0)) / 8.0)[:, None] * np.cos(
    np.pi / 16.0 * np.outer(np.arange(8), 2 * np.arange(8) + 1)
)
"""(8, 8) of each frequency the eight values of its wave."""


def transform(blocks: npt.NDArray[np.floating]) -> Float64:
    """Coefficients (..., 8, 8) of blocks of pixels (..., 8, 8), the slowest first."""
    return _turned(blocks, _WAVES)


def inverse_transform(coefficients: Float64) -> Float64:
    """Pixels (..., 8, 8) of blocks of coefficients (..., 8, 8)."""
    return _turned(coefficients, _WAVES.T)


def _turned(blocks: npt.NDArray[np.floating], waves: Float64) -> Float64:
    flat = np.array(blocks, dtype=np.float64, order="C").reshape(-1, 8, 8)
    _turn(flat, np.ascontiguousarray(waves))
    return flat.reshape(blocks.shape)


@parallel_kernel
def _turn(blocks, waves, call):
    """Each block (B, 8, 8) becomes waves @ block @ waves.T, in its place."""
    for b in share_of(len(blocks), call):
        for i in range(8):
            _weigh(blocks[b, i], waves)
        for j in range(8):
            _weigh(blocks[b, :, j], waves)


@inlined
def _weigh(line, waves):
    """Eight values become their sums with each wave as weights."""
    x0, x1, x2, x3, x4, x5, x6, x7 = line[0], line[1], line[2], line[3], line[4], line[5], line[6], line[7]
    for k in range(8):
        line[k] = (x0 * waves[k, 0] + x1 * waves[k, 1] + x2 * waves[k, 2] + x3 * waves[k, 3]) + (
            x4 * waves[k, 4] + x5 * waves[k, 5] + x6 * waves[k, 6] + x7 * waves[k, 7]
        )
