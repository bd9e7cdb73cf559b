"""The quantisation of SPZ: six sections of bytes from and to the attributes of Gaussians."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.formats.repairs import to_bytes
from engine.formats.smallest_three import put_together, take_apart
from engine.model import Float32, Float64

COLOR_SCALE = 0.15
"""A DC coefficient c is stored as 255 (COLOR_SCALE c + 0.5): wider than a colour, [-3.33, 3.33] fits."""

COLORS, LOG_SCALES = (np.arange(256) / 255.0 - 0.5) / COLOR_SCALE, np.arange(256) / 16.0 - 10.0
"""(256,) DC coefficient and log scale of every byte."""

_SQRT_HALF = np.sqrt(0.5)
_MAGNITUDE = 511
"""Largest 9-bit magnitude of a quaternion component; it stands for sqrt(1/2)."""

_CHUNK = 1 << 15


def decode_positions(section: memoryview, fractional_bits: int) -> Float32:
    """(N, 3) centres from 24-bit fixed point; exact in float32."""
    raw = np.frombuffer(section, dtype=np.uint8).reshape(-1, 3)  # (3 N, 3): three bytes a number
    padded = np.zeros((len(raw), 4), dtype=np.uint8)
    padded[:, 1:] = raw  # the sign bit comes to lie at the top, the shift below brings it down
    fixed = padded.view("<i4")[:, 0] >> 8
    return (fixed * np.float32(2.0**-fractional_bits)).astype(np.float32).reshape(-1, 3)  # (N, 3)


def encode_positions(means: Float32, fractional_bits: int) -> bytes:
    """Inverse of `decode_positions`, rounded to the nearest step."""
    fixed = np.rint(means.astype(np.float64) * 2.0**fractional_bits).astype("<i4").reshape(-1, 1)  # (3 N, 1)
    return fixed.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()


def choose_fractional_bits(means: Float32) -> int:
    """12 as the reference (steps of 1/4096), fewer where the scene would not fit, more where it is small.

    The step is never coarser than about 2^-17 of the farthest coordinate, and 24 bits hold that coordinate.
    """
    reach = float(np.abs(means).max(initial=0.0))
    if reach == 0.0:
        return 12
    exponent = int(np.floor(np.log2(reach)))
    fits = 22 - exponent
    if np.rint(reach * 2.0**fits) > (1 << 23) - 1:
        fits -= 1
    return int(np.clip(max(12, 17 - exponent), 0, min(max(fits, 0), 24)))


def look_up(table: Float64, section: memoryview) -> Float32:
    """(N,) values of a section of bytes, each by one of the tables above."""
    return table.astype(np.float32)[np.frombuffer(section, dtype=np.uint8)]


def decode_first_three(section: memoryview) -> Float32:
    """(N, 4) unit quaternions of version 2: x, y, z in steps of 1/127.5, w >= 0 follows from them."""
    xyz = np.frombuffer(section, dtype=np.uint8).reshape(-1, 3) / 127.5 - 1.0  # (N, 3)
    w = np.sqrt(np.maximum(0.0, 1.0 - np.einsum("nc,nc->n", xyz, xyz)))
    quats = np.concatenate([w[:, None], xyz], axis=1)  # (N, 4)
    # Rounding can push x, y, z beyond the unit sphere; that is the format's error, not a fault of the file.
    return np.asarray((quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32))


def decode_smallest_three(section: memoryview) -> Float32:
    """(N, 4) quaternions of version 3: index of the largest component, three signs and 9-bit magnitudes."""
    packed = np.frombuffer(section, dtype="<u4")
    field = np.arange(1024)
    table = ((field & 511) * (_SQRT_HALF / _MAGNITUDE) * np.where(field & 512, -1, 1)).astype(np.float32)
    small = np.stack([table[(packed >> shift) & 1023] for shift in (20, 10, 0)], axis=1)  # (N, 3)
    return np.ascontiguousarray(put_together(small, packed >> 30)[:, [3, 0, 1, 2]])  # SPZ has x, y, z, w


def encode_smallest_three(quats: Float32) -> bytes:
    """Inverse of `decode_smallest_three`; quaternions (N, 4) of any length but zero."""
    xyzw = quats[:, [1, 2, 3, 0]].astype(np.float64)
    xyzw /= np.linalg.norm(xyzw, axis=1, keepdims=True)
    small, largest = take_apart(xyzw)
    magnitude = np.minimum(np.rint(np.abs(small) * (_MAGNITUDE / _SQRT_HALF)), _MAGNITUDE)
    field = magnitude.astype(np.uint32) | ((small < 0).astype(np.uint32) << np.uint32(9))
    packed = largest.astype(np.uint32) << np.uint32(30)
    for column, shift in enumerate((20, 10, 0)):
        packed |= field[:, column] << np.uint32(shift)
    result: bytes = packed.astype("<u4").tobytes()
    return result


def decode_sh(section: memoryview, sh: Float32) -> None:
    """Fill sh[:, 1:] of an (N, K, 3) array: coefficient-major bytes in steps of 1/128; more than K - 1 are left."""
    if sh.shape[1] == 1:
        return
    raw = np.frombuffer(section, dtype=np.uint8).reshape(len(sh), -1, 3)[:, : sh.shape[1] - 1]  # (N, K - 1, 3)
    for start in range(0, len(sh), _CHUNK):
        part = sh[start : start + _CHUNK, 1:]
        np.subtract(raw[start : start + _CHUNK], np.float32(128.0), out=part, dtype=np.float32)
        part *= np.float32(1.0 / 128.0)


def encode_sh(sh: Float32, signs: Float32) -> bytes:
    """Coefficients 1 to K - 1 of an (N, K, 3) array, times signs (K,), in steps of 1/128 from -1 to 127/128."""
    result = np.empty((len(sh), sh.shape[1] - 1, 3), dtype=np.uint8)
    for start in range(0, len(sh), _CHUNK):
        part = sh[start : start + _CHUNK, 1:] * (signs[1:, None] * np.float32(128.0)) + np.float32(128.0)
        result[start : start + _CHUNK] = to_bytes(part)
    return result.tobytes()


def encode_all(arrays: Sequence[npt.NDArray[Any]], fractional_bits: int, signs: Float32) -> tuple[bytes, ...]:
    """The six sections of means, log scales, quaternions, opacities and sh, in the order of the file: the inverse of
    the decoders, clipped to their ranges."""
    means, log_scales, quats, opacities, sh = arrays
    return (
        encode_positions(means, fractional_bits),
        to_bytes(opacities * np.float32(255.0)).tobytes(),
        to_bytes(sh[:, 0] * signs[0] * np.float32(COLOR_SCALE * 255.0) + np.float32(127.5)).tobytes(),
        to_bytes((log_scales + np.float32(10.0)) * np.float32(16.0)).tobytes(),
        encode_smallest_three(quats),
        encode_sh(sh, signs),
    )
