"""The paper's hard rule (Eq 10), kept so that both decoders can be charted.

As printed, w = round(||c' - c|| / (beta delta)) 1(||c' - c|| <= epsilon) counts steps of displacement and loses their
sign, so it can only tell "moved" from "not moved". On our antipodal marks the step count is taken along the secret
direction (chip times carrier), which is the most favourable reading: a bit is the sign of its code vectors' summed
steps, and what moved further than epsilon is thrown away instead of being trusted less.
"""

import numpy as np
import numpy.typing as npt

from engine.model import Float64, Int32
from engine.watermark.messages import Signs

EPSILON_STEPS = 3.0
"""Tolerance epsilon of Eq 10, in steps beta delta of the code vector."""


def paper_steps(y: Float64, amplitudes: Float64, chips: npt.NDArray[np.int8]) -> Float64:
    """(C,) w of Eq 10 along each chip: whole steps, zero beyond the tolerance.

    Parameters
    ----------
    y : (C,) float64
        Estimated displacements, SH units.
    amplitudes : (C,) float64
        beta_k delta: the displacement that was embedded.
    chips : (C,) int8
    """
    steps = np.where(amplitudes > 0, y * chips / np.maximum(amplitudes, 1e-12), 0.0)
    return np.asarray(np.round(steps) * (np.abs(steps) <= EPSILON_STEPS))


def decode_paper(
    y: Float64, amplitudes: Float64, chips: npt.NDArray[np.int8], bit_of: Int32, bits: int
) -> tuple[Signs, Float64]:
    """Bits (B,) and their votes' lead (B,) in 0..1 by the hard rule; a tie reads as +1 with lead 0."""
    steps = paper_steps(y, amplitudes, chips)
    total = np.bincount(bit_of, steps, bits)
    votes = np.bincount(bit_of, np.abs(steps), bits)
    return np.where(total >= 0, 1, -1).astype(np.int8), np.abs(total) / np.maximum(votes, 1.0)
