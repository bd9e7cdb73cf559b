"""SPZ of Niantic, see `engine.formats.spz`."""

import numpy as np

from engine.formats.declaration import Kind, Range, later
from engine.formats.spz.attributes import choose_fractional_bits
from engine.model import Float32, Float64

_STREAM = later("engine.formats.spz.stream")


def _rounded(means: Float32) -> Float64:
    steps = 2.0 ** choose_fractional_bits(means)
    return np.asarray(np.rint(means.astype(np.float64) * steps) / steps)


KINDS = (
    Kind(
        "spz",
        lambda data, file: data.startswith((b"\x1f\x8b", b"NGSP")),
        lambda data, file, place: _STREAM().read_spz(data, file=file, frame=place.spz_frame),
        lambda model: [_STREAM().write_spz(model)],
        holds=("harmonics", "antialiasing"),
        ranges=(
            Range("colors", -0.5 / 0.15, 0.5 / 0.15, 1 / 255 / 0.15),
            Range("sizes", -10.0, 255 / 16 - 10, 1 / 16),
            Range("harmonics", -1.0, 1.0, 1 / 64),
        ),
        rounded=_rounded,
        step=lambda means: float(2.0 ** -choose_fractional_bits(means.astype(np.float32))),
    ),
)
