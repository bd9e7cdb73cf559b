"""From evidence to a claim, in the terms of an opened record."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import reduce

from engine.errors import InputError
from engine.flows.records.opened_record import OpenedRecord
from engine.model import Camera
from engine.registration.registration_search import Registration
from engine.watermark.claim import (
    LINEAR,
    NOT_FOUND,
    SCATTERED,
    Circumstances,
    Claim,
    ClaimConfig,
    Derivation,
    Transform,
    Verdict,
    decide,
)
from engine.watermark.layers import layer_parts, layered_z, only
from engine.watermark.messages import Signs, message_hex
from engine.watermark.model_evidence import Evidence
from engine.watermark.paper_decoder import adaptive_weights, decode_paper
from engine.watermark.power import Moments, change, moments
from engine.watermark.rates import AppliedRate, Attested, applicable_rate
from engine.watermark.statistics import CHANCE_RATE, log10_binomial_tail, z_threshold

OUT_OF_TIME = "the time budget ended the search: with a larger one the suspect is read in full"
"""What is missing where the part that was read would say that there is no mark."""
ROUTES = ("auto", "model", "render", "image")


@dataclass(frozen=True)
class VerifyConfig:
    """The options of a verification."""

    # Largest acceptable probability of a false claim; counts only where it is stricter than what applies to the record
    # (`rates.applicable_rate`)
    false_claim_rate: float = CHANCE_RATE
    suspect_seen: str = ""  # since when the suspect is known, ISO 8601; empty where unknown
    suspect_existed: str = ""  # by when it is shown to have existed, ISO 8601; empty where that is not shown
    route: str = "auto"  # "auto", "model", "render" or "image"
    decoder: str = "ours"  # "ours", or "paper" (Eq 10 as printed) for the extracted bits; the claim is always ours
    seed: int = 0  # of the registration's trials
    # Wall-clock seconds of one record's search in a model, or, of pictures, for each of them: what would begin later is
    # left out, and named; nothing else depends on the time. Infinity: no limit. Two cores need 15 s in hard cases.
    time_budget: float = 60.0
    # Hypotheses (records times routes) of the whole question, where this verification is one part of it: fixed before
    # any evidence is seen, and counted in every claim. Default: those of this one record, as they come.
    tries: int | None = None

    def __post_init__(self) -> None:
        if self.route not in ROUTES:
            raise InputError(f"route must be one of {', '.join(ROUTES)}, got {self.route!r}")
        if self.decoder not in ("ours", "paper"):
            raise InputError(f"decoder must be 'ours' or 'paper', got {self.decoder!r}")
        if not 0.0 < self.false_claim_rate < 1.0:
            raise InputError(f"false-claim rate must lie in (0, 1), got {self.false_claim_rate}")
        if not self.time_budget > 0.0:
            raise InputError(f"time budget must be positive, got {self.time_budget} s")
        if self.tries is not None and self.tries < 1:
            raise InputError(f"at least one hypothesis is tried, got tries {self.tries}")
        self.rate_for(None)  # refuses a date that is none

    def rate_for(self, attested: Attested | None) -> AppliedRate:
        """The rate that a claim of such a record must meet."""
        return applicable_rate(self.false_claim_rate, attested, self.suspect_seen, self.suspect_existed)


@dataclass(frozen=True, eq=False)
class Reading:
    """What a suspect says along one route, blind to all chips."""

    route: str
    evidence: Evidence
    registration: Registration | None = None  # of a model
    notes: tuple[str, ...] = ()  # for the reader of the claim
    shown: bool = False  # whether the asset was found in the suspect
    derivation: Derivation = NOT_FOUND  # whether, how much of it and where
    pictures: Evidence | None = None  # what pictures of it alone say
    scattered: Evidence | None = None  # pictures read by their scatter (`PictureEvidence.by_scatter`)
    cameras: tuple[Camera | None, ...] = ()  # from where each picture shows the reference; None where it was not read
    copied: Evidence | None = None  # of the copy layer, where the record has one
    left_out: tuple[str, ...] = ()  # steps that the time budget did not allow: there may be more to read

    @property
    def derived_fraction(self) -> float | None:
        """Share of the reference found in the suspect; None where the route does not measure it."""
        return None if self.registration is None else self.registration.derived_fraction


def judge(reading: Reading, opened: OpenedRecord, config: VerifyConfig, tries: int = 1) -> Claim:
    """The claim that a reading supports: its evidence, or the suspect read in another way, where that says more.

    All of it must be counted in `tries`, or in those of the configuration.
    """
    rate = ClaimConfig.at(config.rate_for(opened.attested))
    tries = max(tries, config.tries or 1)
    tint = opened.layout.chips
    spreading = opened.spreading_of(len(reading.evidence.y))
    evidence = reading.evidence.sized(spreading.sizes)
    signs = spreading.signs(opened.message)
    layered = layered_z(evidence, signs, tint)
    chosen, layers = only(evidence, layered.strongest, tint), dict(layered.z)
    parts = layer_parts(len(evidence.y), tint)
    linear = evidence.unsaturated()
    # That of both together lies between them.
    worn = max(change(*(linear or evidence).part(part)) for part in parts.values())
    sums = {name: moments(*evidence.part(part)) for name, part in parts.items()}
    known: Moments | None = (
        reduce(Moments.plus, sums.values()) if layered.strongest == "both" else sums[layered.strongest]
    )
    loudest = max(layered.best, z_threshold(rate.doubt_rate, tries))
    scattered = None if reading.scattered is None else reading.scattered.sized(spreading.sizes)
    for name, way in ((SCATTERED, scattered), (LINEAR, linear)):  # each counted (`search.WAYS`)
        if way is None:
            continue
        other = layered_z(way, signs, tint)
        layers |= {layer + name: z for layer, z in other.z.items()}
        if other.best > loudest:
            loudest, chosen, known = other.best, only(way, other.strongest, tint), None
    circumstances = Circumstances(
        tries=tries,
        route=reading.route,
        copy=opened.copy,
        derivation=reading.derivation,
        transform=_transform(reading.registration),
        notes=(*reading.notes, *_notes(reading)),
        layers=layers if len(layers) > 1 and opened.grain.there else None,
        change=worn,
        sums=known,
        copy_z=None if (copy := read_copy(reading, opened)) is None else copy.z,
    )
    claim = decide(chosen, spreading, opened.message, circumstances, rate)
    if reading.left_out and claim.verdict is Verdict.NOT_MARKED:  # what was not read may hold it
        claim = replace(claim, verdict=Verdict.INCONCLUSIVE, missing=OUT_OF_TIME)
    return _with_paper_bits(claim, reading, opened) if config.decoder == "paper" else claim


@dataclass(frozen=True)
class CopyReading:
    """What a suspect says of the recipient's own layer."""

    z: float  # in the way and attribute in which it speaks loudest
    strength: float  # share of the layer that is left, by least squares over its chips: 1 in an untouched copy


def read_copy(reading: Reading, opened: OpenedRecord, *, either_way: bool = False) -> CopyReading | None:
    """None where the record has no such layer, and its copies have marks of their own."""
    if opened.copies is None or reading.copied is None:
        return None
    spreading = opened.copy_spreading()
    said = reading.copied.sized(spreading.sizes)
    tint = opened.copies.layout.chips
    ways = [said, *(way for way in [said.unsaturated()] if way is not None)]
    found = [layered_z(way, spreading.chips, tint, either_way=either_way).best for way in ways]
    return CopyReading(max(found, key=abs if either_way else float), strength_left(said, spreading.chips))


def strength_left(evidence: Evidence, signs: Signs) -> float:
    """By least squares over its chips, how much of a layer there is; of Gaussians, in whose units y is."""
    expected = float(evidence.weights @ evidence.signal)
    return float((evidence.weights * evidence.y) @ signs) / expected if expected > 0 else 0.0


def _transform(registration: Registration | None) -> Transform | None:
    if registration is None or not registration.found:
        return None
    R, t = registration.R.tolist(), registration.t.tolist()
    return Transform(registration.scale, R, t, registration.mirrored)


def _notes(reading: Reading) -> Iterator[str]:
    """What the registration has to say to the reader of the claim."""
    registration = reading.registration
    if registration is None:
        return
    if not registration.found:
        if reading.route == "model":
            weighed = f"{registration.hypotheses_tried:,} alignments were weighed"
            yield f"no piece of the asset was found in the suspect model; {weighed}"
        return
    if registration.mirrored:
        yield "the suspect model is a mirror image of the asset, and was read as such"
    if registration.deformed:
        yield "the suspect model is deformed: its pieces were matched one by one"
    elif registration.mixed is not None:
        yield "Gaussians of the suspect model were merged: each is read as a mixture of the asset's"


def _with_paper_bits(claim: Claim, reading: Reading, opened: OpenedRecord) -> Claim:
    """The claim with its bits read by the paper's rule (Eq 10 as printed)."""
    evidence, layout = reading.evidence, opened.layout
    tint, spreading = layout.chips, opened.spreading_of(len(evidence.y))
    steps = layout.amplitudes * (opened.strength if reading.route == "model" else _image_gain(evidence, opened))
    chips, bit_of = spreading.chips[:tint], spreading.bit_of[:tint]  # the paper knows of no other layer
    weights = adaptive_weights(evidence.differences, layout.amplitudes) if evidence.differences else None
    bits, lead = decode_paper(evidence.y[:tint], steps, chips, bit_of, len(opened.message), weights)
    matching = int((bits == opened.message).sum())
    return replace(
        claim,
        message=message_hex(bits),
        matching_bits=matching,
        bit_accuracy=matching / len(bits),
        bit_reliability=tuple(0.5 + 0.5 * lead),
        log10_binomial_tail=log10_binomial_tail(matching, len(bits)),
        notes=(*claim.notes, "bits read by the paper's rule (Eq 10); the claim is ours"),
    )


def _image_gain(evidence: Evidence, opened: OpenedRecord) -> float:
    """Pictures give y in units of precision: the paper's step is scaled to the response that was expected."""
    amplitudes = opened.layout.amplitudes
    return float(amplitudes @ evidence.signal[: len(amplitudes)] / max(float(amplitudes @ amplitudes), 1e-300))
