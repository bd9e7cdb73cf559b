"""Task `verify`: whose mark does a suspect carry, of all the records that may explain it?

1. Read the suspect.                                    4. Look for one record's mark after the other.
2. Choose the records: geometry alone, no key.          5. Report the best, and say what was checked.
3. Fix the number of tries that every bound counts.     6. Draw where the mark was found.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from engine.errors import RecordError
from engine.model import Float32, GaussianModel
from engine.pipeline.sealing import OpenedRecord, open_record
from engine.pipeline.verification import Verification, VerifyConfig, verify_images, verify_model
from engine.watermark.checks import NO_RECORD, checks_of
from engine.watermark.claim import Verdict
from engine.watermark.messages import message_hex
from service.problems import Problem
from service.work.evidence_pictures import draw_evidence
from service.work.inputs import Candidate, load_cameras, load_candidates, load_model, load_pictures
from service.work.process import Progress
from service.work.screening import Ranked, rank

COULD_NOT_CHECK = "could_not_check"
"""Stands for a verdict where a record could not be opened."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """A model or pictures, and how to look for one record's mark in them."""

    model: GaussianModel | None
    pictures: list[Float32]
    subject: dict[str, Any]
    look: Callable[[OpenedRecord, VerifyConfig, Progress], Verification]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one candidate came to: a verification, or why its record cannot be used."""

    ranked: Ranked
    opened: OpenedRecord | None
    found: Verification | None
    error: RecordError | None

    @property
    def worth(self) -> tuple[float, ...]:
        """Greater is more telling: marked, then derived, then undecided, then foreign, then not to be opened."""
        if self.found is None:
            return (0.0,)
        claim = self.found.claim
        if claim.verdict is Verdict.MARKED:
            return (4.0, -claim.log10_false_claim)
        if claim.derived_fraction:
            return (3.0, claim.derived_fraction)
        return (2.0 if claim.verdict is Verdict.INCONCLUSIVE else 1.0, -claim.log10_false_claim)

    @property
    def brief(self) -> dict[str, Any]:
        """For the list of all that was tried."""
        claim = self.found.claim if self.found is not None else None
        return {
            "asset": self.ranked.candidate.asset,
            "verdict": claim.verdict.value if claim is not None else COULD_NOT_CHECK,
            "log10_false_claim": claim.log10_false_claim if claim is not None else None,
            "derived_fraction": claim.derived_fraction if claim is not None else None,
        }


def verify_suspect(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """Contract: docs/SERVICE.md."""
    began = time.perf_counter()
    route = request.get("route") or "auto"
    config = VerifyConfig(false_claim_rate=request["false_claim_rate"], route=route)
    candidates = load_candidates(request)
    progress("read", 0.0)
    suspect = _read(request)  # 1
    read = time.perf_counter()
    chosen = _choose(suspect, candidates, progress)  # 2
    # 3. Routes are counted whether or not they come to be tried: the bar is set before the evidence is seen.
    tries = len(chosen) * (2 if suspect.model is not None and route == "auto" else 1)
    config = VerifyConfig(false_claim_rate=config.false_claim_rate, route=route, tries=max(1, tries))
    screened = time.perf_counter()
    best: Outcome | None = None
    tried = []
    seconds = {"read": read - began, "screen": screened - read}
    for number, ranked in enumerate(chosen):  # 4
        outcome = _try(suspect, ranked, config, _part(progress, number, len(chosen)), seconds)
        tried.append(outcome.brief)
        if best is None or outcome.worth > best.worth:
            best = outcome
        if request.get("stop_at_first") and outcome.brief["verdict"] == Verdict.MARKED.value:
            break
    reply = _report(best, tries, suspect)  # 5
    started = time.perf_counter()
    if best is not None and best.opened is not None and best.found is not None:
        progress("picture", 0.0)
        picture = suspect.pictures[0] if suspect.pictures else None
        reply["files"] = draw_evidence(folder, best.opened, best.found, suspect.model, picture)  # 6
        seconds["picture"] = time.perf_counter() - started
    return reply | {
        "subject": suspect.subject,
        "screened": len(candidates) if suspect.model is not None and len(candidates) > 1 else 0,
        "tried": tried,
        "seconds": time.perf_counter() - began,
        "seconds_by_stage": seconds,
    }


def _read(request: Mapping[str, Any]) -> Suspect:
    paths = list(request.get("images") or ())
    if bool(paths) == (request.get("model") is not None):
        raise Problem("invalid-request", "a suspect is one model, or pictures, not both and not neither")
    if not paths:
        loaded = load_model(request)
        model = loaded.model
        subject: dict[str, Any] = {"format": loaded.format, "gaussians": len(model), "pictures": 0}
        return Suspect(model, [], subject, lambda opened, c, p: verify_model(model, opened, c, p))
    cameras = load_cameras(request.get("cameras"), count=len(paths))
    pictures = load_pictures(paths)
    subject = {"format": "pictures", "gaussians": None, "pictures": len(pictures)}
    return Suspect(None, pictures, subject, lambda opened, c, p: verify_images(pictures, opened, c, cameras, p))


def _choose(suspect: Suspect, candidates: list[Candidate], progress: Progress) -> list[Ranked]:
    """Records to try. Of a model: those it resembles, or the one it resembles most; of pictures: all."""
    if suspect.model is None or len(candidates) == 1:
        return [Ranked.unscreened(candidate) for candidate in candidates]
    ranked = rank(suspect.model, candidates, progress)
    return [each for each in ranked if each.alike] or ranked[:1]


def _try(
    suspect: Suspect, ranked: Ranked, config: VerifyConfig, progress: Progress, seconds: dict[str, float]
) -> Outcome:
    candidate = ranked.candidate
    started = time.perf_counter()
    progress("open record", 0.0)
    try:
        opened = open_record(candidate.record.read_bytes(), candidate.key)
    except RecordError as error:
        return Outcome(ranked, None, None, error)
    finally:
        seconds["open record"] = seconds.get("open record", 0.0) + time.perf_counter() - started
    found = suspect.look(opened, config, progress)
    for stage, spent in found.seconds_by_stage.items():
        seconds[stage] = seconds.get(stage, 0.0) + spent
    return Outcome(ranked, opened, found, None)


def _part(progress: Progress, number: int, count: int) -> Progress:
    """Progress of one candidate; of several, the fraction is over all of them."""
    if count == 1:
        return progress
    return lambda stage, fraction: progress(f"record {number + 1} of {count}", (number + fraction) / count)


def _report(best: Outcome | None, tries: int, suspect: Suspect) -> dict[str, Any]:
    """The part of the reply that speaks of the best candidate."""
    nothing: dict[str, Any] = {"asset": None, "claim": None, "record": None, "registered_message": None, "files": {}}
    if best is None:
        return nothing | {"tries": 0, "checks": [NO_RECORD]}
    claim = best.found.claim.to_json() if best.found is not None else None
    reply = nothing | {
        "asset": best.ranked.candidate.asset,
        "tries": tries,
        "claim": claim,
        "checks": checks_of(claim, best.error, len(suspect.pictures)),
    }
    if best.opened is not None:
        reply["record"] = best.opened.header.to_json()
        reply["registered_message"] = message_hex(best.opened.message)
    return reply
