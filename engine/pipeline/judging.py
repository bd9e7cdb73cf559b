"""From evidence to a claim, in the terms of an opened record."""

from dataclasses import dataclass, replace

from engine.errors import InputError
from engine.pipeline.sealing import OpenedRecord
from engine.registration.registering import Registration
from engine.watermark.claim import Claim, ClaimConfig, decide
from engine.watermark.messages import message_hex
from engine.watermark.model_evidence import Evidence
from engine.watermark.paper_decoder import decode_paper
from engine.watermark.statistics import log10_binomial_tail

ROUTES = ("auto", "model", "render", "image")
ABSENCE_POWER = 0.999
"""Probability that the registration finds a piece of the asset that is there (measured: docs/RESULTS.md)."""
LEAST_PIECE = 64
"""Gaussians below which a suspect is too small for that: its silence says nothing. As few as a mark itself needs."""


@dataclass(frozen=True)
class VerifyConfig:
    """What a verification can be told."""

    false_claim_rate: float = 1e-9  # largest acceptable probability of a false claim, against chance
    route: str = "auto"  # "auto", "model", "render" or "image"
    decoder: str = "ours"  # "ours", or "paper" (Eq 10 as printed) for the extracted bits; the claim is always ours
    seed: int = 0  # of the registration's trials
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
        if self.tries is not None and self.tries < 1:
            raise InputError(f"at least one hypothesis is tried, got tries {self.tries}")


def judge(
    evidence: Evidence,
    opened: OpenedRecord,
    route: str,
    tries: int,
    config: VerifyConfig,
    registration: Registration | None = None,
    notes: tuple[str, ...] = (),
) -> Claim:
    """The claim that this evidence supports."""
    spreading = opened.spreading
    transform, fraction, absence = None, None, None
    if registration is not None:
        fraction = registration.derived_fraction
        if registration.found:
            transform = {
                "scale": registration.scale,
                "rotation": registration.R.tolist(),
                "translation": registration.t.tolist(),
            }
            if registration.deformed:
                notes = (*notes, "the suspect model is deformed: its pieces were matched one by one")
            elif registration.mixed is not None:
                notes = (*notes, "Gaussians of the suspect model were merged: each is read as a mixture of the asset's")
        elif route == "model":
            absence = ABSENCE_POWER if len(registration.matches) >= LEAST_PIECE else None
            notes = (*notes, "no piece of the asset was found in the suspect model")
    claim = decide(
        evidence.y,
        evidence.weights,
        evidence.signal,
        spreading.bit_of,
        spreading.chips,
        opened.message,
        tries=max(tries, config.tries or 1),
        config=ClaimConfig(false_claim_rate=config.false_claim_rate),
        route=route,
        copy=opened.copy,
        derived_fraction=fraction,
        absence_power=absence,
        transform=transform,
        notes=notes,
    )
    if config.decoder == "paper":
        steps = opened.layout.amplitudes * (opened.strength if route == "model" else _image_gain(evidence, opened))
        bits, lead = decode_paper(evidence.y, steps, spreading.chips, spreading.bit_of, len(opened.message))
        matching = int((bits == opened.message).sum())
        claim = replace(
            claim,
            message=message_hex(bits),
            matching_bits=matching,
            bit_accuracy=matching / len(bits),
            bit_reliability=tuple(0.5 + 0.5 * lead),
            log10_binomial_tail=log10_binomial_tail(matching, len(bits)),
            notes=(*claim.notes, "bits read by the paper's rule (Eq 10); the claim is ours"),
        )
    return claim


def _image_gain(evidence: Evidence, opened: OpenedRecord) -> float:
    """Pictures give y in units of precision: the paper's step is scaled to the response that was expected."""
    amplitudes = opened.layout.amplitudes
    return float(amplitudes @ evidence.signal / max(float(amplitudes @ amplitudes), 1e-300))
