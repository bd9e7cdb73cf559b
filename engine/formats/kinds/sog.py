"""SOG of PlayCanvas, see `engine.formats.sog`."""

import numpy as np

from engine.formats.declaration import Kind, later
from engine.model import Float32, Float64

_BUNDLE, _ENCODING = later("engine.formats.sog.bundle"), later("engine.formats.sog.encoding")


def _step(means: Float64) -> float:
    """At the median center, on the axis of the widest range; see `engine.formats.sog.encoding.position_codes`."""
    bent = np.sign(means) * np.log1p(np.abs(means))
    steps = np.ptp(bent, axis=0) / 65535 * (1 + np.abs(np.median(means, axis=0)))
    return float(steps.max())


def _rounded(means: Float32) -> Float64:
    codes, mins, maxs = _ENCODING().position_codes(means)
    bent = mins + codes / 65535.0 * (maxs - mins)
    return np.asarray(np.sign(bent) * np.expm1(np.abs(bent)))


KINDS = (
    Kind(
        "sog",
        lambda data, file: data.startswith(b"PK") and b"meta.json" in data,
        lambda data, file, _: _BUNDLE().read_sog(data, file=file),
        lambda model: [_BUNDLE().write_sog(model)],
        holds=("harmonics", "discs", "antialiasing"),
        rounded=_rounded,
        step=_step,
    ),
)
