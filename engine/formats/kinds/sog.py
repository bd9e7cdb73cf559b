"""SOG of PlayCanvas, see `engine.formats.sog`."""

from collections.abc import Iterable

import numpy as np

from engine.formats.declaration import Kind, Read
from engine.model import Float32, Float64, GaussianModel


def _read(data: bytes, file: str, spz_frame: str) -> Read:
    from engine.formats.sog.bundle import read_sog

    return read_sog(data, file=file)


def _write(model: GaussianModel) -> Iterable[bytes]:
    from engine.formats.sog.bundle import write_sog

    return [write_sog(model)]


def _step(means: Float64) -> float:
    """At the median center, on the axis of the widest range; see `engine.formats.sog.encoding.position_codes`."""
    bent = np.sign(means) * np.log1p(np.abs(means))
    steps = np.ptp(bent, axis=0) / 65535 * (1 + np.abs(np.median(means, axis=0)))
    return float(steps.max())


def _rounded(means: Float32) -> Float64:
    from engine.formats.sog.encoding import position_codes

    codes, mins, maxs = position_codes(means)
    bent = mins + codes / 65535.0 * (maxs - mins)
    return np.asarray(np.sign(bent) * np.expm1(np.abs(bent)))


KINDS = (
    Kind(
        "sog",
        lambda data, file: data.startswith(b"PK") and b"meta.json" in data,
        _read,
        _write,
        holds=("harmonics", "discs", "antialiasing"),
        rounded=_rounded,
        step=_step,
    ),
)
