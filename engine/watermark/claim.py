"""The claim: what a verification answers, and the numbered steps that lead to it (DESIGN 4.9)."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float64
from engine.watermark.derivation import NOT_FOUND, Derivation
from engine.watermark.messages import message_hex
from engine.watermark.power import Moments, moments
from engine.watermark.rates import AppliedRate
from engine.watermark.statistics import (
    CHANCE_RATE,
    DISHONEST_CLAIMANT_RATE,
    Signs,
    bit_sums,
    decode_bits,
    log10_binomial_tail,
    log10_false_claim_bound,
    signed_z,
    weighted_evidence,
    z_threshold,
)

SCATTERED = "_by_scatter"
"""What follows the names of `layers.LAYERS` in a claim where pictures were read by their scatter."""


class Verdict(StrEnum):
    """The three answers. "No mark found" is a result, not an error."""

    MARKED = "marked"
    NOT_MARKED = "not_marked"  # derived from the asset; this copy's mark is absent or was taken out
    INCONCLUSIVE = "inconclusive"


@dataclass(frozen=True)
class ClaimConfig:
    """What an answer must satisfy."""

    # Largest false-claim bound, all tries counted, of the answer `marked`; in (0, 1)
    false_claim_rate: float = CHANCE_RATE
    rate_basis: str = "attested"  # why this rate applies, a key of `rates.BASES`
    # The rate that would apply if the registration were attested and older than the suspect; None where it cannot be
    rate_if_attested: float | None = None
    power: float = 0.999  # least proven power of the answer `not_marked`; in (0, 1)
    # Share of the mark's amplitude assumed left when power is computed, in (0, 1]: `not_marked` says that even a mark
    # worn down to this share would have been seen
    surviving: float = 0.5
    # Largest change measured along the mark's directions, in sizes of the mark, of the answer `not_marked`: what moved
    # them by more may as well have covered a mark. Unmarked models measure 0.04 to 0.2 as they are, cut or in another
    # format (.spz 0.3), copies with another mark and cleaned ones 0.9 and more; colours alone of such 0.3 and more
    room: float = 0.25
    # A bound below this, though above the false-claim rate, forbids the answer `not_marked`, as does a Z so far below
    # 0; in (0, 1)
    doubt_rate: float = 1e-3

    @classmethod
    def at(cls, rate: AppliedRate) -> "ClaimConfig":
        """The usual demands, at the rate that applies."""
        return cls(false_claim_rate=rate.rate, rate_basis=rate.basis, rate_if_attested=rate.if_attested)

    def __post_init__(self) -> None:
        for name in ("false_claim_rate", "power", "doubt_rate"):
            if not 0 < getattr(self, name) < 1:
                raise InputError(f"{name} must lie in (0, 1), got {getattr(self, name)}")
        if not 0 < self.surviving <= 1:
            raise InputError(f"surviving must lie in (0, 1], got {self.surviving}")
        if not self.room > 0:
            raise InputError(f"room must be positive, got {self.room}")


@dataclass(frozen=True)
class Claim:
    """The answer of one verification, with everything it rests on."""

    verdict: Verdict
    # 1 - min(1, tries * bound): one minus the largest probability that a key with no part in the suspect would have
    # come this far. It is not a probability that the suspect is marked.
    confidence: float
    log10_false_claim: float  # log10 of that bound, tries counted; <= 0
    z: float  # observed: the claim statistic
    unmarked_z: float  # expected without a mark (or under a wrong key): 0, with a standard deviation of 1
    expected_z: float  # expected if the mark were there at full strength
    z_threshold: float  # the z at which the bound meets `false_claim_rate` for this number of tries
    false_claim_rate: float  # the rate that applies, fixed before the evidence was seen
    rate_basis: str  # why it applies, a key of `rates.BASES`
    # The bound is below what would be enough if the registration were attested and older than the suspect, and above
    # what applies: the verdict is `inconclusive`
    would_be_claim_if_attested: bool
    # Whether the bound is at most 2^-128 too: needed where the record is not known to be older than the suspect
    meets_dishonest_claimant_rate: bool
    tries: int  # hypotheses tried (records x transforms x routes)
    # Proven lower bound of the probability to reach the threshold, had the mark been there at the `surviving` share of
    # its strength
    power: float
    # Size of what was measured along the mark's directions, in sizes of the mark; None where nothing was measured
    change: float | None
    message: str  # extracted bits in hexadecimal (a bit without evidence reads 0)
    # Length of the message; how many bits equal the registered ones (a bit without evidence does not)
    bits: int
    matching_bits: int
    bit_accuracy: float  # matching_bits / bits
    bit_reliability: tuple[float, ...]  # for each bit, the probability that it was read right; 0.5 is a coin
    # log10 of the chance that as many bits match by luck, tries not counted. Weaker than the bound above, which also
    # uses how clearly each bit was read; reported because the literature does.
    log10_binomial_tail: float
    derivation: Derivation  # whether the suspect was made from the asset; stands whatever the verdict is
    transform: dict[str, Any] | None  # from suspect to reference, as the route found it
    route: str  # kind of evidence
    copy: str  # name of the copy whose mark was looked for
    missing: str  # what an inconclusive answer lacks; otherwise empty
    notes: tuple[str, ...]  # for the reader
    # z of both layers of the mark together and of each alone; the claim rests on the strongest. None where there is one
    layers: dict[str, float] | None = None

    @property
    def derived_fraction(self) -> float | None:
        """Share of the reference found in the suspect; None where the route does not measure it."""
        return self.derivation.share

    def to_json(self) -> dict[str, Any]:
        """Plain dict of JSON values."""
        plain = asdict(self) | {"derived": self.derivation.derived, "derived_fraction": self.derived_fraction}
        plain.update(verdict=self.verdict.value, bit_reliability=list(self.bit_reliability), notes=list(self.notes))
        return plain


def decide(
    y: Float64,
    w: Float64,
    signal: Float64,
    bit_of: npt.NDArray[np.integer],
    chips: Signs,
    message: Signs,
    *,
    tries: int = 1,
    config: ClaimConfig | None = None,
    route: str = "",
    copy: str = "",
    derivation: Derivation = NOT_FOUND,
    transform: Mapping[str, Any] | None = None,
    notes: tuple[str, ...] = (),
    layers: Mapping[str, float] | None = None,
    change: float | None = None,
    sums: Moments | None = None,
) -> Claim:
    """From evidence to claim.

    Parameters
    ----------
    y, w : (C,)
        Displacement estimates and weights >= 0, made without looking at chips or message.
    signal : (C,)
        What chip times bit times y would be if the mark were there unharmed and y had no noise. Enters power,
        expectation and reliability, never Z.
    bit_of, chips : (C,)
        Bit and secret sign of each chip.
    message : (B,) +-1
        The registered message.
    tries : int
        Number of (record, transform, route) hypotheses tried in this verification, >= 1.
    derivation : Derivation, optional
        How much of the asset was recognised in the suspect; without any the answer is never `not_marked`.
    notes : tuple of str
    layers : mapping, optional
        Z of each layer of the mark, where y is the loudest of several: none may be suspicious for `not_marked`.
    change : float, optional
        Largest `Moments.change` of those layers; that of y where there is but one.
    sums : Moments, optional
        Those of y, w and signal, where they are known.
    """
    config = config or ClaimConfig()
    signal = np.broadcast_to(np.asarray(signal, dtype=np.float64), np.shape(y))

    # 1. The bar is set before the evidence is looked at.
    threshold = z_threshold(config.false_claim_rate, tries)
    # 2. One statistic, for the registered message.
    c = weighted_evidence(y, w)
    z = signed_z(c, chips * message[bit_of])
    # 3. How often would a key with no part in this suspect come as far, all tries counted?
    log10_bound = log10_false_claim_bound(z, tries)
    # 4. Would this evidence have shown the mark, even a worn one, and is there no room for one that was covered?
    sums = moments(y, w, signal) if sums is None else sums
    expected, strength = sums.expected_z, sums.worn(config.surviving).power(threshold)
    change = sums.change if change is None else change
    # 5. The answer.
    loudest = max(abs(each) for each in (z, *(layers or {}).values()))  # far below 0: turned round
    doubtful = log10_false_claim_bound(loudest, tries) < math.log10(config.doubt_rate)
    if z >= threshold:
        verdict = Verdict.MARKED
    elif derivation.derived and strength >= config.power and change <= config.room and not doubtful:
        verdict = Verdict.NOT_MARKED
    else:
        verdict = Verdict.INCONCLUSIVE
    # 6. What an undecided answer lacks.
    attested_rate = config.rate_if_attested or config.false_claim_rate
    would = verdict is not Verdict.MARKED and z >= z_threshold(attested_rate, tries)
    missing = ""
    if verdict is Verdict.INCONCLUSIVE:
        if doubtful and z == loudest:  # the evidence itself says what a mark would give
            missing = _more((threshold / z) ** 2)
        elif not expected > 0:
            missing = "no part of the asset could be measured in the suspect"
        elif not derivation.derived:
            missing = "too little of the asset was recognized in the suspect"
        elif strength >= config.power or doubtful:
            missing = _COVERED
        else:
            missing = _more(sums.worn(config.surviving).evidence_needed(threshold, config.power))
    # 7. The bits: reported, but no part of the answer.
    n_bits = len(message)
    T, norm = bit_sums(c, bit_of, chips, n_bits)
    bits, reliability = decode_bits(T, norm, _bit_strength(w, signal, bit_of, norm))
    matches = int((bits == message).sum())

    return Claim(
        verdict=verdict,
        confidence=-math.expm1(log10_bound * math.log(10)),
        log10_false_claim=log10_bound,
        z=z,
        unmarked_z=0.0,
        expected_z=expected,
        z_threshold=threshold,
        false_claim_rate=config.false_claim_rate,
        rate_basis=config.rate_basis,
        would_be_claim_if_attested=would,
        meets_dishonest_claimant_rate=log10_bound <= math.log10(DISHONEST_CLAIMANT_RATE),
        tries=tries,
        power=strength,
        change=change if math.isfinite(change) else None,
        message=message_hex(bits),
        bits=n_bits,
        matching_bits=matches,
        bit_accuracy=matches / n_bits,
        bit_reliability=tuple(float(r) for r in reliability),
        log10_binomial_tail=log10_binomial_tail(matches, n_bits),
        derivation=derivation,
        transform=dict(transform) if transform is not None else None,
        route=route,
        copy=copy,
        missing=missing,
        notes=tuple(notes),
        layers=None if layers is None else dict(layers),
    )


def _bit_strength(w: Float64, signal: Float64, bit_of: npt.NDArray[np.integer], norm: Float64) -> Float64:
    """(B,) expected T_b / norm_b up to a common factor."""
    if not signal.any():
        return np.ones_like(norm)
    sums = np.bincount(bit_of, weights=w * signal, minlength=len(norm)).astype(np.float64)
    return np.divide(np.maximum(sums, 0), norm, out=np.zeros_like(norm), where=norm > 0)


_COVERED = (
    "the suspect deviates from the original too much to exclude a watermark: it may carry another one, or this one was"
    " covered or removed"
)


def _more(times: float) -> str:
    if times > 1000:
        return "more than 1,000 times as much evidence of this kind is needed"
    return f"about {max(times, 1.1):.1f} times as much evidence of this kind is needed"
