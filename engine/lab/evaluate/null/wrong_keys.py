"""Samples of the null distribution: Z of keys unrelated to a suspect."""

# mypy: allow-untyped-defs

import math

import numpy as np

from engine.kernels.jit import parallel_kernel, share_of
from engine.model import Float64
from engine.watermark.keys import SUBKEY_BYTES, keystream
from engine.watermark.statistics import weighted_evidence

__all__ = ["wrong_key_z"]

_BATCH, _MOST = 1 << 15, 1 << 28  # keys at a time; and bytes of their keystream
_BLOCK = 2048  # keys whose sums stay in the fastest cache


def wrong_key_z(y: Float64, w: Float64, seed: bytes, count: int) -> Float64:
    """(count,) Z of keys unrelated to the evidence: samples of the null distribution, given y and w.

    The message and the dealing of bits only flip signs that are fair anyway, so neither is needed. Eight
    chips at a time become one byte of keystream and one look-up of their 256 possible sums: a million keys of
    690,000 chips take about two and a half minutes of one core.

    Parameters
    ----------
    y, w : (C,)
    seed : bytes
        32 bytes; the same seed gives the same keys.
    """
    if len(seed) != SUBKEY_BYTES:
        raise ValueError(f"seed must have {SUBKEY_BYTES} bytes, got {len(seed)}")
    c = weighted_evidence(y, w)
    norm = math.sqrt(float(c @ c))
    if norm == 0:
        return np.zeros(count)
    c = np.pad(c / norm, (0, -len(c) % 8)).reshape(-1, 8)  # (C/8, 8)
    patterns = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1, bitorder="little")
    sums = c @ (2.0 * patterns.T - 1.0)  # (C/8, 256) every byte's signed sum
    z, batch = np.zeros(count), max(1, min(_BATCH, _MOST // len(sums)))
    for number, start in enumerate(range(0, count, batch)):
        part = z[start : start + batch]
        stream = keystream(seed, len(sums) * len(part), f"null{number}").reshape(len(sums), len(part))
        _look_up(sums, stream, part, _BLOCK)
    return z


@parallel_kernel
def _look_up(sums, stream, z, block, call):
    """Add to `z` (K,) of each row of `stream` (R, K) of bytes the sums (R, 256) that they name, four rows at a time."""
    rows = len(sums) - len(sums) % 4
    for piece in share_of((len(z) + block - 1) // block, call):
        start, end = piece * block, min((piece + 1) * block, len(z))
        for r in range(0, rows, 4):
            for k in range(start, end):
                first = sums[r, stream[r, k]] + sums[r + 1, stream[r + 1, k]]
                z[k] += first + sums[r + 2, stream[r + 2, k]] + sums[r + 3, stream[r + 3, k]]
        for r in range(rows, len(sums)):
            for k in range(start, end):
                z[k] += sums[r, stream[r, k]]
