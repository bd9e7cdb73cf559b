"""What a file of some format cannot hold of a model, row by row: values beyond its ranges, centers that it rounds."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.formats.ply.compressed import rounded_positions
from engine.formats.repairs import VISIBLE_ROUNDING
from engine.formats.spz.attributes import choose_fractional_bits
from engine.model import SH_C0, Bool, Float32, Float64, GaussianModel

__all__ = ["losses"]


@dataclass(frozen=True)
class _Range:
    """What a format holds of an attribute, and in which steps, in the units of the values."""

    name: str
    values: Callable[[GaussianModel], Float32]  # (N, ...)
    low: float
    high: float
    step: float  # twice what it rounds by within its range

    def beyond(self, model: GaussianModel) -> Bool:
        """(N,) which Gaussians are clipped by more than rounding."""
        values = self.values(model).reshape(len(model), -1)
        if not values.shape[1]:
            return np.zeros(len(model), dtype=np.bool_)
        low, high = self.low - self.step / 2, self.high + self.step / 2
        return np.asarray((values.min(axis=1) < low) | (values.max(axis=1) > high))


def _dc(model: GaussianModel) -> Float32:
    return model.sh[:, 0]


def _rest(model: GaussianModel) -> Float32:
    return model.sh[:, 1:]


def _sizes(model: GaussianModel) -> Float32:
    return model.log_scales


_RANGES = {
    "splat": (_Range("colors", _dc, -0.5 / SH_C0, 0.5 / SH_C0, 1 / 255 / SH_C0),),
    "spz": (
        _Range("colors", _dc, -0.5 / 0.15, 0.5 / 0.15, 1 / 255 / 0.15),
        _Range("sizes", _sizes, -10.0, 255 / 16 - 10, 1 / 16),
        _Range("harmonics", _rest, -1.0, 1.0, 1 / 64),
    ),
    "compressed.ply": (_Range("sizes", _sizes, -20.0, 20.0, 0.0), _Range("harmonics", _rest, -4.0, 4.0, 1 / 16)),
}


def losses(model: GaussianModel, format: str) -> Iterator[str]:
    """A sentence on each kind of loss beyond rounding, with the number of Gaussians and the first one's row."""
    for each in _RANGES.get(format, ()):
        rows = np.flatnonzero(each.beyond(model))
        if len(rows):
            yield f"{_counted(model, rows)}: {each.name} beyond the range of .{format} were clipped"
    if format in _ROUNDED:
        error = np.abs(_ROUNDED[format](model.means).astype(np.float32) - model.means).max(axis=1)
        size = np.exp(np.median(model.log_scales, axis=1).astype(np.float64))  # of a disc, within its plane
        rows = np.flatnonzero(error > VISIBLE_ROUNDING * size)
        if len(rows):
            most = f"up to {error[rows].max():.2g}, more than 1/20 of their size"
            yield f"{_counted(model, rows)}: .{format} rounds their centers by {most}"


def _counted(model: GaussianModel, rows: npt.NDArray[np.intp]) -> str:
    noun = "Gaussian" if len(rows) == 1 else "Gaussians"
    return f"{len(rows):,} {noun} (first in row {model.row_of(int(rows[0]))})"


def _spz(means: Float32) -> Float64:
    steps = 2.0 ** choose_fractional_bits(means)
    return np.asarray(np.rint(means.astype(np.float64) * steps) / steps)


def _sog(means: Float32) -> Float64:
    from engine.formats.sog.encoding import position_codes

    codes, mins, maxs = position_codes(means)
    bent = mins + codes / 65535.0 * (maxs - mins)
    return np.asarray(np.sign(bent) * np.expm1(np.abs(bent)))


_ROUNDED = {"spz": _spz, "sog": _sog, "compressed.ply": rounded_positions}
"""Centers as the formats of one range for many rows hold them."""
