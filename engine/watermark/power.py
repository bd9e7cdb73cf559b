"""What the evidence would have shown, had the mark been there: expected Z and the power to see it.

Under the alternative the observed y is taken as noise to which the mark is added: y' = y + signal * eps, eps
the fair signs of a key that has not seen y. That is exact for an unmarked suspect, the case a "not marked"
answer speaks about; on a marked one the mark itself counts as noise, so both numbers err on the low side.

With S = sum w s, Q = sum w^2 (y^2 + s^2), R = sum w^2 y s eps: Z' = (S + sum w y eps) / sqrt(Q + 2 R). Since
sqrt(Q + 2 R) <= sqrt(Q) + R / sqrt(Q) (tangent of a concave function), Z' >= t follows from

    S - t sqrt(Q) + sum a eps >= 0,   a = w y (1 - t w s / sqrt(Q)),

a Rademacher sum again: the power is *at least* 1 - exp(-x^2 / 2), x = (S - t sqrt(Q)) / |a|, whatever y is.
"""

import math
from typing import NamedTuple

import numpy as np

from engine.model import Float64
from engine.watermark.config import CONFIG
from engine.watermark.statistics import magnitude

_SMALL = 1e-200
"""Sums of squares above this, and below one over it, lose nothing that matters."""


class Moments(NamedTuple):
    """Sums over the chips that all these questions are answered from."""

    signal: float  # S
    noise: float  # sum (w y)^2
    mark: float  # sum (w s)^2; with the first, Q
    mixed: tuple[float, float]  # sums (w y)^2 w s and (w y)^2 (w s)^2
    unit: float = 1.0  # in which w y and w s are measured

    @property
    def root(self) -> float:
        """sqrt(Q)."""
        return math.sqrt(self.noise + self.mark)

    @property
    def expected_z(self) -> float:
        """See the function."""
        return self.signal / self.root if self.root > 0 else 0.0

    def worn(self, share: float) -> "Moments":
        """Those of a mark of which so much is left."""
        mixed = share * self.mixed[0], share**2 * self.mixed[1]
        return Moments(share * self.signal, self.noise, share**2 * self.mark, mixed, self.unit)

    def plus(self, other: "Moments") -> "Moments":
        """Those of both evidences, on different chips."""
        unit = max(self.unit, other.unit)
        powers = np.array([1, 2, 2, 3, 4])
        both = np.zeros(5)
        for part in (self, other):
            both += (part.unit / unit) ** powers * (part.signal, part.noise, part.mark, *part.mixed)
        signal, noise, mark, *mixed = both.tolist()
        return Moments(signal, noise, mark, (mixed[0], mixed[1]), unit)

    def power(self, threshold: float, proven: bool = True) -> float:
        """Probability that the mark would have reached Z >= `threshold`, from `statistics.z_threshold`.

        Proven, it is the lower bound of this module's text, which holds for every y; else the normal approximation,
        close for evidence of many chips of similar weight.
        """
        root = self.root
        margin = self.signal - threshold * root
        slope = threshold / root if root > 0 else 0.0
        spread = math.sqrt(max(0.0, self.noise - 2.0 * slope * self.mixed[0] + slope**2 * self.mixed[1]))  # |a|
        if spread == 0:
            return 1.0 if margin >= 0 and root > 0 else 0.0
        x = margin / spread
        if not proven:
            return 0.5 * math.erfc(-x / math.sqrt(2))
        return -math.expm1(-x * x / 2) if x > 0 else 0.0

    def evidence_needed(self, threshold: float, target: float) -> float:
        """How many times this evidence would give a proven power of `target`; inf where it shows nothing.

        k independent pieces like this one multiply S by k and Q and |a|^2 by k, so
        sqrt(k) S = threshold sqrt(Q) + x |a|, x = sqrt(-2 ln(1 - target)).
        """
        if self.signal <= 0:
            return math.inf
        x = math.sqrt(-2 * math.log1p(-target))  # of |a| without the threshold's term, which fades as 1 / sqrt(k)
        return ((threshold * self.root + x * math.sqrt(self.noise)) / self.signal) ** 2


def moments(y: Float64, w: Float64, signal: Float64 | float) -> Moments:
    """The sums of some evidence; the arguments are those of `expected_z`. ValueError unless they are finite and weights
    at least 0."""
    y, w, signal = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (y, w, signal)))
    found = _sums(y, w, signal, 1.0, 1.0)
    if all(_SMALL < size < 1.0 / _SMALL for size in (found.noise + found.mark, found.mixed[1] or 1.0)):
        return found
    # Not finite, or squares so large or small that digits are lost: looked at closely.
    largest = magnitude(y), magnitude(w), magnitude(signal)
    if not all(map(math.isfinite, largest)):
        raise ValueError("evidence and signal must be finite")
    unit = max(largest[0], largest[2]) or 1.0
    shown = np.maximum(np.abs(y / unit), np.abs(signal / unit)) * (w / (largest[1] or 1.0))
    return _sums(y, w, signal, unit, (largest[1] or 1.0) * (float(shown.max(initial=0.0)) or 1.0))


def change(y: Float64, w: Float64, signal: Float64) -> float:
    """Size of what was measured, in sizes of the mark: sqrt(sum (w y)^2 / sum (w s)^2); inf where none is expected.

    Power takes for granted that what lies over the mark knows nothing of it. Who cleans a stolen model does: he puts an
    estimate of the mark against it, and then Z is small, too. But an estimate of correlation r with the mark leaves
    sqrt(1 / r^2 - 1) of the mark's size behind when it takes all of Z: only near the original there is no room for it.
    The arguments are those of `moments`, with weights that do not fall with the size of y.
    """
    expected = np.abs(w * signal)
    mark = float(expected @ expected)
    measured = w * np.minimum(np.abs(y), CONFIG.power.far * np.abs(signal))
    return math.sqrt(float(measured @ measured) / mark) if mark > 0 else math.inf


def _sums(y: Float64, w: Float64, signal: Float64, unit: float, top: float) -> Moments:
    """`moments` of y and signal in units, weights in tops."""
    sums, least = np.zeros(5), 0.0
    for start in range(0, len(y), CONFIG.power.rows):
        rows = slice(start, start + CONFIG.power.rows)
        weights = w[rows] / top
        wy, ws = y[rows] / unit * weights, signal[rows] / unit * weights
        noise, mark = wy * wy, ws * ws
        sums += ws.sum(), noise.sum(), mark.sum(), noise @ ws, noise @ mark
        least = min(least, float(weights.min()))
    if least < 0:
        raise ValueError(f"weights must be >= 0, the smallest is {w.min()}")
    total, of_noise, of_mark, *mixed = sums.tolist()
    return Moments(total, of_noise, of_mark, (mixed[0], mixed[1]), unit * top)


def expected_z(y: Float64, w: Float64, signal: Float64) -> float:
    """Z that a mark of amplitude `signal` would give in this evidence: S / sqrt(Q).

    y and w (C,) are displacement estimates and weights >= 0. The signal, (C,) or one for all, is the mark's amplitude
    as y would show it, in the unit of y; negative where neighbouring chips push a chip's y against its own sign.
    """
    return moments(y, w, signal).expected_z
