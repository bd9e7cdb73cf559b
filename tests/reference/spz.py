"""Slow, obviously right twin of the SPZ decoder: one Gaussian at a time, as nianticlabs/spz defines it."""

from __future__ import annotations

import math
import struct

import numpy as np


def decode_gaussian(sections: list[bytes], i: int, version: int, fractional_bits: int, rest: int) -> dict:
    """Gaussian i of the six sections, in the axes of the file; alpha stays in 0..1."""
    positions, alphas, colors, scales, rotations, sh = sections
    if version == 1:  # IEEE 754 half floats
        means = [struct.unpack_from("<e", positions, 6 * i + 2 * a)[0] * 2.0**fractional_bits for a in range(3)]
    else:
        means = [int.from_bytes(positions[9 * i + 3 * a : 9 * i + 3 * a + 3], "little", signed=True) for a in range(3)]
    if version < 3:
        x, y, z = (rotations[3 * i + a] / 127.5 - 1.0 for a in range(3))
        quat = np.array([math.sqrt(max(0.0, 1.0 - x * x - y * y - z * z)), x, y, z])
    else:
        packed = int.from_bytes(rotations[4 * i : 4 * i + 4], "little")
        largest, xyzw, squares = packed >> 30, [0.0] * 4, 0.0
        for a in (3, 2, 1, 0):
            if a == largest:
                continue
            value = math.sqrt(0.5) * (packed & 511) / 511
            xyzw[a] = -value if packed >> 9 & 1 else value
            squares += value * value
            packed >>= 10
        xyzw[largest] = math.sqrt(max(0.0, 1.0 - squares))
        quat = np.array([xyzw[3], *xyzw[:3]])
    return {
        "means": np.array(means) / 2.0**fractional_bits,
        "alpha": alphas[i] / 255,
        "dc": np.array([(colors[3 * i + c] / 255 - 0.5) / 0.15 for c in range(3)]),
        "log_scales": np.array([scales[3 * i + a] / 16 - 10 for a in range(3)]),
        "quats": quat / np.linalg.norm(quat),
        "rest": np.array([(sh[3 * rest * i + k] - 128) / 128 for k in range(3 * rest)]).reshape(rest, 3),
    }
