"""The paper's hard rule (Eq 10), kept so that both decoders can be charted.

As printed, w = round(||c' - c|| / (beta delta)) 1(||c' - c|| <= epsilon) counts steps of displacement and loses their
sign, so it can only tell "moved" from "not moved". On our antipodal marks the step count is taken along the secret
direction (chip times carrier), which is the most favourable reading: a bit is the sign of its code vectors' summed
steps, and what moved further than epsilon is thrown away instead of being trusted less.

Of a model the steps are weighted, too ("adaptive extraction"): by beta, which grows with the code vector's uncertainty,
and by how little of its difference is detail over the coefficients. What the stages leave to each other (Eq 11) is
compensated where displacements are gathered (`model_evidence`).
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from engine.model import Float64, Int32
from engine.numerics.wavelet import coefficient_detail
from engine.watermark.config import CONFIG
from engine.watermark.messages import Signs


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
    return np.asarray(np.round(steps) * (np.abs(steps) <= CONFIG.paper.epsilon_steps))


def adaptive_weights(differences: Sequence[Float64], amplitudes: Float64) -> Float64:
    """(C,) what each step of a model counts: its beta against the usual one, times its code vector's reliability.

    Reliability is E / (E + lambda E_detail) of the difference c' - c, E its energy and E_detail that of its detail
    (one Haar step over the coefficients); with DC alone there is no detail, and all are 1.

    Parameters
    ----------
    differences : sequence of (M, D) float64
        Of each stage, see `Evidence`.
    amplitudes : (C,) float64
        beta_k delta of each chip.
    """
    parts = []
    carriers = len(amplitudes) // sum(len(stage) for stage in differences)
    for stage in differences:
        energy = (stage**2).sum(axis=1)
        detail = (coefficient_detail(stage.reshape(len(stage), -1, 3)) ** 2).sum(axis=(1, 2))
        reliable = np.where(energy > 0, energy / np.maximum(energy + CONFIG.paper.lambda_freq * detail, 1e-300), 1.0)
        parts.append(np.repeat(reliable, carriers))
    usual = float(np.median(amplitudes[amplitudes > 0])) if (amplitudes > 0).any() else 1.0
    return np.asarray(np.concatenate(parts) * amplitudes / usual)


def decode_paper(
    y: Float64,
    amplitudes: Float64,
    chips: npt.NDArray[np.int8],
    bit_of: Int32,
    bits: int,
    weights: Float64 | None = None,
) -> tuple[Signs, Float64]:
    """Bits (B,) and their votes' lead (B,) in 0..1 by the hard rule; a tie reads as +1 with lead 0.

    Steps count alike, or as much as weights (C,) say.
    """
    steps = paper_steps(y, amplitudes, chips)
    if weights is not None:
        steps = weights * steps
    total = np.bincount(bit_of, steps, bits)
    votes = np.bincount(bit_of, np.abs(steps), bits)
    return np.where(total >= 0, 1, -1).astype(np.int8), np.abs(total) / np.maximum(votes, 1.0)
