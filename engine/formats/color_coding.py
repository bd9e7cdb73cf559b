"""What the numbers of a picture are where no color profile says it: by PNG's cICP and gAMA, and AVIF's nclx.

Code points of primaries and transfer functions: ITU-T H.273. PQ and HLG: ITU-R BT.2100; the white of what is not HDR
lies at 203 cd/m2 in either (ITU-R BT.2408).
"""

import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.model import Float32, Float64
from engine.numerics.srgb import from_linear, to_linear

_WHITE = 203.0  # cd/m2
_BRIGHTEST = 0.999
"""Share of the pixels that are to lie below white: a desktop may show the white of a page at 480 cd/m2."""

_SIGNALLED = re.compile(rb"\x00\x00\x00\x04cICP(..)|colrnclx(....)", re.DOTALL)
_PRIMARIES = {
    1: (0.3127, 0.329, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06),
    9: (0.3127, 0.329, 0.708, 0.292, 0.17, 0.797, 0.131, 0.046),
    11: (0.314, 0.351, 0.68, 0.32, 0.265, 0.69, 0.15, 0.06),
    12: (0.3127, 0.329, 0.68, 0.32, 0.265, 0.69, 0.15, 0.06),
}
"""x and y of white, red, green and blue. Those of television before BT.709 are close to it."""

_ROWS_AT_ONCE = 64  # of a picture, in double precision

_SRGB_GAMMA, _SAME_GAMMA = 0.45455, 0.01


def _pq(signal: Float64) -> Float64:
    """BT.2100, table 4."""
    root = np.maximum(signal, 0.0) ** (32 / 2523)
    share = np.maximum(root - 0.8359375, 0.0) / (18.8515625 - 18.6875 * root)
    return np.asarray(10000 / _WHITE * share ** (8192 / 1305))


def _hlg(signal: Float64) -> Float64:
    """BT.2100, table 5, on a display of 1,000 cd/m2."""
    scene = np.where(signal <= 0.5, signal**2 / 3, (np.exp((signal - 0.55991073) / 0.17883277) + 0.28466892) / 12)
    luminance = scene @ np.array([0.2627, 0.678, 0.0593])
    return np.asarray(1000 / _WHITE * scene * luminance[..., None] ** 0.2)


_LIGHT: Mapping[int, Callable[[Float64], Float64]] = {
    4: lambda signal: signal**2.2,
    5: lambda signal: signal**2.8,
    8: lambda signal: signal,
    16: _pq,
    18: _hlg,
}
"""Linear light, 1 for white, of the transfer functions that are not displayed as sRGB's."""


@dataclass(frozen=True)
class Coding:
    """Primaries, and linear light of a signal from 0 to 1."""

    primaries: tuple[float, ...]
    light: Callable[[Float64], Float64] = to_linear

    def to_srgb(self, values: Float32) -> Float32:
        """(H, W, 3) sRGB values of such ones. Light beyond white is scaled down to it, but for the brightest pixels."""
        matrix = np.linalg.solve(_to_xyz(_PRIMARIES[1]), _to_xyz(self.primaries))
        matrix /= matrix.sum(axis=1, keepdims=True)  # white stays white
        light = np.empty_like(values)
        for top in range(0, len(values), _ROWS_AT_ONCE):
            block = values[top : top + _ROWS_AT_ONCE].astype(np.float64)
            light[top : top + _ROWS_AT_ONCE] = self.light(block) @ matrix.T
        white = max(1.0, float(np.quantile(light.max(axis=2), _BRIGHTEST)))
        return from_linear(np.clip(light / white, 0.0, 1.0)).astype(np.float32)


def _to_xyz(primaries: tuple[float, ...]) -> Float64:
    """(3, 3) XYZ of linear red, green and blue."""
    x, y = np.array(primaries, dtype=np.float64).reshape(4, 2).T
    xyz = np.stack([x / y, np.ones(4), (1 - x - y) / y])  # (3, 4), white first
    return np.asarray(xyz[:, 1:] * np.linalg.solve(xyz[:, 1:], xyz[:, 0]))


def coding_of(head: bytes, info: Mapping[Any, Any]) -> Coding | None:
    """The coding of a PNG or an AVIF, by its bytes before the pixels and by what Pillow read of them; None for sRGB, or
    where a color profile counts."""
    found = _SIGNALLED.search(head)
    if found and (found[1] or "icc_profile" not in info):
        primaries, transfer = tuple(found[1]) if found[1] else struct.unpack(">HH", found[2])
        coding = Coding(_PRIMARIES.get(primaries, _PRIMARIES[1]), _LIGHT.get(transfer, to_linear))
        return None if coding == Coding(_PRIMARIES[1]) else coding
    gamma = info.get("gamma", _SRGB_GAMMA)
    if "icc_profile" in info or "srgb" in info or abs(gamma - _SRGB_GAMMA) < _SAME_GAMMA or not 0.1 < gamma <= 2:
        return None
    return Coding(_PRIMARIES[1], lambda signal: np.asarray(signal ** (1 / gamma)))
