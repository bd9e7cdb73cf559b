"""The one decoder and the theorem behind every claim (DESIGN 4.8 and 4.9; paper Eq 10 and 11).

All evidence arrives as one flat list of chips i = 0..C-1 (a chip is one code vector in one carrier
direction): `y[i]` the estimated displacement along the carrier, `w[i] >= 0` how far to trust it, `bit_of[i]`
in 0..B-1 the bit it carries, `chips[i]` = +-1 the secret sign, `message[b]` = +-1 the bit.

**Theorem (Hoeffding 1963).** If the signs message[bit_of[i]] * chips[i] are independent fair coins given all
c[i] = w[i] * y[i], then Z = sum sign[i] c[i] / sqrt(sum c[i]^2) obeys P(Z >= z) <= exp(-z^2 / 2) for every
z > 0 and *every* c: nothing is assumed about the suspect, its distribution or its author.

**What it needs.** Chips come from a keyed pseudo-random stream (`keys.signs`) and c must not have seen them:
not the reference, the codebooks, the assignment to code vectors, the weights, the registration, nor any
choice of what to keep. It holds for a key that had no part in making the suspect.

**How it would be lost.**

1. Rebuilding the reference as "marked minus my mark": every key then finds itself.
2. Chips not bound to the hash of the reference: a claimant subtracts a mark of his own from a public model
   and calls the rest his original.
3. Weights or outlier rejection that look at chips * y.
4. Listing one chip twice, say once per image: its terms share one sign, and the norm is too small
   (`model_evidence.Evidence.plus` sums instead).
5. Not counting every hypothesis tried (`tries`).

tests/theory plays 1, 2 and 4.
"""

import math

import numpy as np
import numpy.typing as npt

from engine.model import Float64
from engine.watermark.config import CONFIG

Signs = npt.NDArray[np.int8]

CHANCE_RATE = 1e-9
"""False-claim rate against chance: enough where the record is known to be older than the suspect."""
DISHONEST_CLAIMANT_RATE = 2.0**-128
"""Rate against a claimant free to try keys and altered originals on a public model: 128-bit work."""

_LN10 = math.log(10.0)


def weighted_evidence(y: Float64, w: Float64) -> Float64:
    """(C,) c = w * y in float64, scaled so that its largest magnitude is 1 (Z does not depend on scale).

    ValueError if shapes differ, a value is not finite, or a weight is negative.
    """
    y, w = np.asarray(y, dtype=np.float64), np.asarray(w, dtype=np.float64)
    if y.ndim != 1 or y.shape != w.shape:
        raise ValueError(f"y and w must be equally long lists, got shapes {y.shape} and {w.shape}")
    largest, heaviest = magnitude(y), float(w.max(initial=0.0))
    if w.min(initial=0.0) < 0:
        raise ValueError(f"weights must be >= 0, the smallest is {w.min()}")
    if not (math.isfinite(largest) and math.isfinite(heaviest)):
        raise ValueError("evidence must be finite: give weight 0 and y 0 to what could not be measured")
    # Each is scaled, so that no square or sum over- or underflows where it matters.
    c = y / (largest or 1.0)
    c *= w / (heaviest or 1.0)
    c /= magnitude(c) or 1.0
    return c


def magnitude(values: Float64) -> float:
    """The largest absolute value, 0 of none; not finite where one is not."""
    low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    return max(-low, high) if low == low else low  # NaN is in both, and in no comparison


def claim_z(y: Float64, w: Float64, bit_of: npt.NDArray[np.integer], chips: Signs, message: Signs) -> float:
    """The claim statistic Z of this module's theorem.

    Between -sqrt(C) and sqrt(C); 0 where there is no evidence.

    Parameters
    ----------
    y, w : (C,)
        Displacement estimates and weights >= 0, finite.
    bit_of : (C,) int
    chips : (C,) +-1
    message : (B,) +-1
        The *registered* message, never the decoded one.
    """
    return signed_z(weighted_evidence(y, w), chips * message[bit_of])


def signed_z(c: Float64, signs: Signs) -> float:
    """Z of weighted evidence c (C,) and the signs (C,) that chips and message stand for together."""
    norm = math.sqrt(float(c @ c))
    return float(c @ signs.astype(np.float64)) / norm if norm > 0 else 0.0


def log10_false_claim_bound(z: float, tries: int = 1) -> float:
    """log10 of min(1, tries * exp(-z^2 / 2)): how likely any of `tries` unrelated keys reaches z."""
    if tries < 1:
        raise ValueError(f"at least one hypothesis was tried, got {tries}")
    bound = -z * z / 2 / _LN10 if z > 0 else 0.0
    return min(0.0, bound + math.log10(tries))


def z_threshold(rate: float, tries: int = 1) -> float:
    """The z at which `log10_false_claim_bound(z, tries)` equals log10(rate); 0 < rate <= 1."""
    if not 0 < rate <= 1:
        raise ValueError(f"a false-claim rate lies in (0, 1], got {rate}")
    if tries < 1:
        raise ValueError(f"at least one hypothesis was tried, got {tries}")
    return math.sqrt(2 * (math.log(tries) - math.log(rate)))


def bit_sums(c: Float64, bit_of: npt.NDArray[np.integer], chips: Signs, n_bits: int) -> tuple[Float64, Float64]:
    """Sum and norm of each bit's evidence, c (C,) from `weighted_evidence`.

    Returns
    -------
    T : (B,) float64
        T_b = sum over the chips i of bit b of chips[i] * c[i]. The bit is its sign.
    norm : (B,) float64
        sqrt(sum c[i]^2): for a wrong key, P(T_b / norm_b >= z) <= exp(-z^2 / 2).
    """
    T = np.bincount(bit_of, weights=c * chips, minlength=n_bits).astype(np.float64)
    norm: Float64 = np.sqrt(np.bincount(bit_of, weights=c * c, minlength=n_bits))
    if len(T) != n_bits:
        raise ValueError(f"bit_of names bit {len(T) - 1}, but the message has {n_bits} bits")
    return T, norm


def decode_bits(T: Float64, norm: Float64, strength: Float64 | None = None) -> tuple[Signs, Float64]:
    """Bits (B,), +-1 or 0 where there is no evidence at all, and the probability (B,) in [0.5, 1] that each is right.

    Model: z_b = T_b / norm_b is standard normal noise around message_b * a * s_b, or around 0 with a prior
    probability of e = 0.05 (a bit whose signal alone was lost). s_b (`strength`) says how strong bit b is
    relative to the others; the one unknown is fitted, a^2 = max(0, sum(z^2 - 1)) / sum(s^2). With u = |z_b|,
    v = a s_b and r = (1 - e) exp(-v^2 / 2), the posterior probability that sign(T_b) is right is

        (r exp(u v) + e) / (r exp(u v) + r exp(-u v) + 2 e)

    An unmarked model gives a near 0, hence reliabilities near 0.5.

    Parameters
    ----------
    T, norm : (B,)
        From `bit_sums`.
    strength : (B,) optional
        Expected T_b / norm_b up to a common factor, >= 0. Default: equal bits, as the assignment deals them.
    """
    z = np.divide(T, norm, out=np.zeros_like(T), where=norm > 0)
    s = np.ones_like(z) if strength is None else np.asarray(strength, dtype=np.float64)
    s = np.where(norm > 0, s, 0.0)
    seen = s > 0
    energy = float((s[seen] ** 2).sum())
    a = math.sqrt(max(0.0, float((z[seen] ** 2 - 1).sum())) / energy) if energy > 0 else 0.0
    u, v = np.abs(z), a * s
    top = np.maximum(u * v - v * v / 2, 0.0)  # the largest exponent: nothing overflows
    right = (1 - CONFIG.power.lost_bit) * np.exp(u * v - v * v / 2 - top)
    wrong = (1 - CONFIG.power.lost_bit) * np.exp(-u * v - v * v / 2 - top)
    lost = CONFIG.power.lost_bit * np.exp(-top)
    reliability = (right + lost) / (right + wrong + 2 * lost)
    return np.sign(T).astype(np.int8), reliability


def log10_binomial_tail(matches: int, bits: int) -> float:
    """log10 P(at least `matches` of `bits` fair coins agree with the message), exact."""
    if not 0 <= matches <= bits:
        raise ValueError(f"{matches} of {bits} bits cannot match")
    ways = sum(math.comb(bits, j) for j in range(matches, bits + 1))
    return min(0.0, math.log10(ways) - bits * math.log10(2))
