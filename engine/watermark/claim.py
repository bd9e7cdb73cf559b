"""The claim: what a verification answers, and the numbered steps that lead to it (DESIGN 4.9)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float64
from engine.numerics.plain import Json
from engine.watermark.messages import message_hex
from engine.watermark.power import Moments, moments
from engine.watermark.power import change as measured
from engine.watermark.rates import AppliedRate, Condition
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

if TYPE_CHECKING:
    from engine.watermark.model_evidence import Evidence
    from engine.watermark.spreading import Spreading

SCATTERED = "_by_scatter"
"""What follows the names of `layers.LAYERS` in a claim where pictures were read by their scatter."""


LINEAR = "_unsaturated"
"""And where what Gaussians say counts in proportion."""


class Verdict(StrEnum):
    """The three answers. "No mark found" is a result, not an error."""

    MARKED = "marked"
    NOT_MARKED = "not_marked"  # it equals the unmarked original to rounding, or a part of it: no acquittal
    INCONCLUSIVE = "inconclusive"


Corner = tuple[float, float, float]


@dataclass(frozen=True)
class Derivation:
    """How much of the registered asset is in a suspect, how exactly and where."""

    derived: bool  # the asset, or a piece of it, was recognised in the suspect
    # Share of the reference's Gaussians that were found; None where the route does not measure it
    share: float | None = None
    gaussians: int | None = None  # Gaussians of the suspect that were recognised; None likewise
    # Median distance of a recognised Gaussian from where the reference has it, in that Gaussian's own standard
    # deviations; None where there is no one similarity, or nothing was matched
    exactness: float | None = None
    # Box around what was found, its 1 % and 99 % quantiles along each axis, in the reference's coordinates
    where: tuple[Corner, Corner] | None = None
    views: tuple[int, int] | None = None  # pictures in which it was recognised, of so many looked at


NOT_FOUND = Derivation(False)
"""Nothing of the asset was recognised."""


@dataclass(frozen=True)
class ClaimConfig:
    """What an answer must satisfy."""

    # Largest false-claim bound, all tries counted, of the answer `marked`; in (0, 1)
    false_claim_rate: float = CHANCE_RATE
    rate_basis: str = "attested"  # why this rate applies, a key of `rates.BASES`
    # The rate that would apply if the registration were attested and older than the suspect; None where it cannot be
    rate_if_attested: float | None = None
    conditions: tuple[Condition, ...] = ()  # under which that rate would apply
    draws: int = 1  # records that may have been tried out beforehand: each multiplies the hypotheses
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
    def at(cls, rate: AppliedRate) -> ClaimConfig:
        """The usual demands, at the rate that applies."""
        return cls(rate.rate, rate.basis, rate.if_attested, rate.conditions, rate.tries)

    def __post_init__(self) -> None:
        for name in ("false_claim_rate", "power", "doubt_rate"):
            if not 0 < getattr(self, name) < 1:
                raise InputError(f"{name} must lie in (0, 1), got {getattr(self, name)}")
        if not 0 < self.surviving <= 1:
            raise InputError(f"surviving must lie in (0, 1], got {self.surviving}")
        if not self.room > 0:
            raise InputError(f"room must be positive, got {self.room}")


@dataclass(frozen=True)
class Transform:
    """From suspect to reference, as a registration found it: x_reference = scale * R x_suspect + translation."""

    scale: float
    rotation: list[list[float]]  # R, 3 rows
    translation: list[float]  # scene units of the reference
    mirrored: bool = False  # x of the suspect is negated first


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
    tries: int  # hypotheses tried (records x transforms x routes, x draws where a time-stamping service drew)
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
    transform: Transform | None  # as the route found it
    route: str  # kind of evidence
    copy: str  # name of the copy whose record it is
    missing: str  # what an inconclusive answer lacks; otherwise empty
    notes: tuple[str, ...]  # for the reader
    # z of both layers of the mark together and of each alone; the claim rests on the strongest. None where there is one
    layers: dict[str, float] | None = None
    # z of the layer by which this copy differs from others, tries counted in `copy_named`; None where there is no such
    # layer: of records before format 3, whose claim is about one copy, and of models marked without a recipient
    copy_z: float | None = None
    # Whether it is this copy, or made from it, at CHANCE_RATE: the recipient is sought in an asset that is the
    # owner's already. None where `copy_z` is
    copy_named: bool | None = None
    # Under which the answer would be a claim, where `would_be_claim_if_attested`
    conditions: tuple[Condition, ...] = ()

    @property
    def derived_fraction(self) -> float | None:
        """Share of the reference found in the suspect; None where the route does not measure it."""
        return self.derivation.share

    def to_json(self) -> Json:
        """Plain dict of JSON values."""
        plain = asdict(self) | {"derived": self.derivation.derived, "derived_fraction": self.derived_fraction}
        plain.update(verdict=self.verdict.value, bit_reliability=list(self.bit_reliability), notes=list(self.notes))
        plain.update(conditions=[condition.to_json() for condition in self.conditions])
        return plain


@dataclass(frozen=True)
class Circumstances:
    """What a claim rests on besides evidence and mark: what was tested, and what is known without chips."""

    tries: int = 1  # number of (record, transform, route) hypotheses tried in this verification, >= 1
    route: str = ""  # kind of evidence
    copy: str = ""  # name of the copy whose mark is looked for
    # How much of the asset was recognized in the suspect; without any the answer is never `not_marked`
    derivation: Derivation = NOT_FOUND
    transform: Transform | None = None
    notes: tuple[str, ...] = ()  # for the reader of the claim
    # z of each layer of the mark, where the evidence is the loudest of several: none may be suspicious for `not_marked`
    layers: Mapping[str, float] | None = None
    change: float | None = None  # largest `power.change` of those layers; default: that of the evidence
    sums: Moments | None = None  # those of the evidence, where they are known
    copy_z: float | None = None  # of the copy layer, where there is one


def decide(
    evidence: Evidence,
    spreading: Spreading,
    message: Signs,
    known: Circumstances | None = None,
    config: ClaimConfig | None = None,
) -> Claim:
    """From evidence to claim, in seven steps, whose order is law.

    1. Set the threshold, before the evidence is looked at.
    2. Compute one statistic, for the registered message.
    3. Bound how often an unrelated key comes as far, all tries counted.
    4. Compute the power to see the mark, even a worn one, and the room for one that was covered.
    5. Answer.
    6. Name what an inconclusive answer lacks.
    7. Read the bits: reported, but no part of the answer.

    Parameters
    ----------
    evidence : Evidence
        Made without looking at chips or message. Its `signal` enters power, expectation and reliability, never z.
    spreading : Spreading
        Bit and secret sign of each of the C chips.
    message : (B,) +-1
        The registered message.
    known : Circumstances, optional
    config : ClaimConfig, optional
        What an answer must satisfy.
    """
    known, config = known or Circumstances(), config or ClaimConfig()
    tries = known.tries * config.draws
    # 1. Set the threshold.
    threshold = z_threshold(config.false_claim_rate, tries)
    # 2. Compute one statistic.
    c = weighted_evidence(evidence.y, evidence.weights)
    z = signed_z(c, spreading.signs(message))
    # 3. Bound how often an unrelated key comes as far.
    log10_bound = log10_false_claim_bound(z, tries)
    # 4. Compute power and room.
    sums = moments(evidence.y, evidence.weights, evidence.signal) if known.sums is None else known.sums
    strength = sums.worn(config.surviving).power(threshold)
    change = measured(evidence.y, evidence.weights, evidence.signal) if known.change is None else known.change
    loudest = max(abs(each) for each in (z, *(known.layers or {}).values()))  # far below 0: turned round
    doubtful = log10_false_claim_bound(loudest, tries) < math.log10(config.doubt_rate)
    # 5. Answer.
    if z >= threshold:
        verdict = Verdict.MARKED
    elif known.derivation.derived and strength >= config.power and change <= config.room and not doubtful:
        verdict = Verdict.NOT_MARKED
    else:
        verdict = Verdict.INCONCLUSIVE
    # 6. Name what an inconclusive answer lacks.
    attested_z = z_threshold(config.rate_if_attested or config.false_claim_rate, tries)
    missing = ""
    if verdict is Verdict.INCONCLUSIVE:
        needed = _Needed(threshold, attested_z, doubtful and z > (1.0 - 1e-9) * loudest)
        if needed.seen:  # the evidence itself says what a mark would give
            missing = _short(z, needed, known.derivation, config)
        elif not sums.expected_z > 0:
            missing = _unmeasured(known.derivation)
        elif not known.derivation.derived:
            missing = "too little of the asset was recognized in the suspect"
        elif doubtful:
            missing = _OPPOSED.format(-loudest)
        elif strength >= config.power:
            missing = _COVERED.format(100.0 * config.power)
        else:
            missing = _short(z, needed, known.derivation, config)
            if known.derivation.views is None:  # pictures are never called unmarked, however many there are
                times = sums.worn(config.surviving).evidence_needed(threshold, config.power)
                missing += f"; {_times(times)} would show a watermark at half strength"
    # 7. Read the bits.
    bits, reliability = _read_bits(evidence, c, spreading, len(message))
    matches = int((bits == message).sum())

    would = verdict is not Verdict.MARKED and z >= attested_z
    return Claim(
        verdict=verdict,
        confidence=-math.expm1(log10_bound * math.log(10)),
        log10_false_claim=log10_bound,
        z=z,
        unmarked_z=0.0,
        expected_z=sums.expected_z,
        z_threshold=threshold,
        false_claim_rate=config.false_claim_rate,
        rate_basis=config.rate_basis,
        would_be_claim_if_attested=would,
        conditions=config.conditions if would else (),
        meets_dishonest_claimant_rate=log10_bound <= math.log10(DISHONEST_CLAIMANT_RATE),
        tries=tries,
        power=strength,
        change=change if math.isfinite(change) else None,
        message=message_hex(bits),
        bits=len(message),
        matching_bits=matches,
        bit_accuracy=matches / len(message),
        bit_reliability=tuple(float(r) for r in reliability),
        log10_binomial_tail=log10_binomial_tail(matches, len(message)),
        derivation=known.derivation,
        transform=known.transform,
        route=known.route,
        copy=known.copy,
        missing=missing,
        notes=known.notes,
        layers=None if known.layers is None else dict(known.layers),
        copy_z=known.copy_z,
        copy_named=None if known.copy_z is None else known.copy_z >= z_threshold(CHANCE_RATE, known.tries),
    )


def _read_bits(evidence: Evidence, c: Float64, spreading: Spreading, bits: int) -> tuple[Signs, Float64]:
    """(B,) bits and the probability that each was read right."""
    T, norm = bit_sums(c, spreading.bit_of, spreading.chips, bits)
    return decode_bits(T, norm, _bit_strength(evidence.weights, evidence.signal, spreading.bit_of, norm))


def _bit_strength(w: Float64, signal: Float64, bit_of: npt.NDArray[np.integer], norm: Float64) -> Float64:
    """(B,) expected T_b / norm_b up to a common factor."""
    if not signal.any():
        return np.ones_like(norm)
    sums = np.bincount(bit_of, weights=w * signal, minlength=len(norm)).astype(np.float64)
    return np.divide(np.maximum(sums, 0), norm, out=np.zeros_like(norm), where=norm > 0)


_COVERED = (
    "a watermark at half its strength would have been found with a probability of at least {:.1f} %, and none was; yet"
    " the suspect deviates from the original too much to exclude one: it may be unmarked, carry another one, or this"
    " one was covered or removed"
)
_OPPOSED = (
    "what was measured is opposed to the watermark (z {:.1f}), which chance hardly explains: more than the watermark"
    " may have been removed"
)


class _Needed(NamedTuple):
    """What z would be a claim."""

    z: float
    z_if_attested: float
    seen: bool  # whether the evidence is more than chance explains: then a mark like it would add up


def _unmeasured(derivation: Derivation) -> str:
    """Nothing of the suspect would show a watermark, were it there."""
    if derivation.derived and derivation.views is not None:
        return "the pictures show the asset, but too coarsely to measure a watermark: larger or clearer ones may help"
    return "no part of the asset could be measured in the suspect"


def _short(z: float, needed: _Needed, derivation: Derivation, config: ClaimConfig) -> str:
    """How short of a claim the evidence falls, in numbers; how much more would do, only where it shows something.

    z of equally clear evidence adds up as a root of a sum of squares.
    """
    text = f"z {z:.1f} of the {needed.z:.1f} needed"
    if not needed.seen:
        return text
    times = (needed.z / z) ** 2
    if derivation.views is None:
        text += f"; {_times(times)} would do"
    else:
        more = max(1, math.ceil(derivation.views[0] * (times - 1.0)))
        text += f"; about {more:,} more such {'picture' if more == 1 else 'pictures'} of the same copy would do"
    if z < needed.z_if_attested < needed.z and config.conditions:
        conditions = " and ".join(condition.text for condition in config.conditions)
        text += f"; z {needed.z_if_attested:.1f} would do if {conditions}"
    return text


def _times(times: float) -> str:
    if times > 1000:
        return "more than 1,000 times as much evidence of this kind"
    return f"about {max(times, 1.1):.1f} times as much evidence of this kind"
