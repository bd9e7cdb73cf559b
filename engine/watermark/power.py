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
from engine.watermark.statistics import magnitude


class _Moments(NamedTuple):
    signal: float  # S
    root: float  # sqrt(Q)
    spread: float  # |a|
    mark: float  # |w s|


def _moments(y: Float64, w: Float64, signal: Float64, threshold: float) -> _Moments:
    y, w, signal = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (y, w, signal)))
    largest = magnitude(y), magnitude(w), magnitude(signal)
    if not all(map(math.isfinite, largest)):
        raise ValueError("evidence and signal must be finite")
    if w.min(initial=0.0) < 0:
        raise ValueError(f"weights must be >= 0, the smallest is {w.min()}")
    unit = max(largest[0], largest[2]) or 1.0
    wy, ws = y / unit, signal / unit
    wy *= w
    ws *= w
    top = max(magnitude(wy), magnitude(ws)) or 1.0
    wy /= top
    ws /= top
    root = math.sqrt(float(wy @ wy + ws @ ws))
    total, mark = float(ws.sum()), math.sqrt(float(ws @ ws))
    if root > 0:  # w y times 1 - threshold w s / root, in place: there may be 60 million chips
        ws *= threshold
        ws /= root
        np.subtract(1.0, ws, out=ws)
        wy *= ws
    return _Moments(total, root, math.sqrt(float(wy @ wy)), mark)


def expected_z(y: Float64, w: Float64, signal: Float64) -> float:
    """Z that a mark of amplitude `signal` would give in this evidence: S / sqrt(Q).

    y and w (C,) are displacement estimates and weights >= 0. The signal, (C,) or one for all, is the mark's amplitude
    as y would show it, in the unit of y; negative where neighbouring chips push a chip's y against its own sign.
    """
    m = _moments(y, w, signal, 0.0)
    return m.signal / m.root if m.root > 0 else 0.0


def measured_change(y: Float64, w: Float64, signal: Float64) -> float:
    """Size of what was measured, in sizes of the mark: sqrt(sum (w y)^2 / sum (w s)^2); inf where no mark is expected.

    Power takes for granted that what lies over the mark knows nothing of it. Who cleans a stolen model does: he puts an
    estimate of the mark against it, and then Z is small, too. But an estimate of correlation r with the mark leaves
    sqrt(1 / r^2 - 1) of the mark's size behind when it takes all of Z: only near the original there is no room for it.
    """
    m = _moments(y, w, signal, 0.0)  # at threshold 0 a is w y
    return m.spread / m.mark if m.mark > 0 else math.inf


def power(y: Float64, w: Float64, signal: Float64, threshold: float, proven: bool = True) -> float:
    """Probability that a mark of amplitude `signal` would have reached Z >= `threshold` in this evidence.

    Parameters
    ----------
    y, w, signal
        As in `expected_z`.
    threshold : float
        From `statistics.z_threshold`, > 0.
    proven : bool
        True: the lower bound of this module's text, which holds for every y. False: the normal approximation,
        close for evidence of many chips of similar weight.
    """
    m = _moments(y, w, signal, threshold)
    margin = m.signal - threshold * m.root
    if m.spread == 0:
        return 1.0 if margin >= 0 and m.root > 0 else 0.0
    x = margin / m.spread
    if not proven:
        return 0.5 * math.erfc(-x / math.sqrt(2))
    return -math.expm1(-x * x / 2) if x > 0 else 0.0


def evidence_needed(y: Float64, w: Float64, signal: Float64, threshold: float, target: float) -> float:
    """How many times this evidence would give a proven power of `target`; inf where it shows nothing.

    k independent pieces like this one multiply S by k and Q and |a|^2 by k, so
    sqrt(k) S = threshold sqrt(Q) + x |a|, x = sqrt(-2 ln(1 - target)).
    """
    m = _moments(y, w, signal, 0.0)  # |a| without the threshold's term, which fades as 1 / sqrt(k)
    if m.signal <= 0:
        return math.inf
    x = math.sqrt(-2 * math.log1p(-target))
    return ((threshold * m.root + x * m.spread) / m.signal) ** 2
