"""SPZ of Niantic, see `engine.formats.spz`."""

from collections.abc import Iterable

import numpy as np

from engine.formats.declaration import Kind, Read, dc_range, rest_range, size_range
from engine.formats.spz.attributes import choose_fractional_bits
from engine.model import Float32, Float64, GaussianModel


def _read(data: bytes, file: str, spz_frame: str) -> Read:
    from engine.formats.spz.stream import read_spz

    return read_spz(data, file=file, frame=spz_frame)


def _write(model: GaussianModel) -> Iterable[bytes]:
    from engine.formats.spz.stream import write_spz

    return [write_spz(model)]


def _step(means: Float64) -> float:
    return 2.0 ** -choose_fractional_bits(means.astype(np.float32))


def _rounded(means: Float32) -> Float64:
    steps = 2.0 ** choose_fractional_bits(means)
    return np.asarray(np.rint(means.astype(np.float64) * steps) / steps)


KINDS = (
    Kind(
        "spz",
        lambda data, file: data.startswith((b"\x1f\x8b", b"NGSP")),
        _read,
        _write,
        holds=("harmonics", "antialiasing"),
        ranges=(
            dc_range(-0.5 / 0.15, 0.5 / 0.15, 1 / 255 / 0.15),
            size_range(-10.0, 255 / 16 - 10, 1 / 16),
            rest_range(-1.0, 1.0, 1 / 64),
        ),
        rounded=_rounded,
        step=_step,
    ),
)
