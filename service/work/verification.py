"""Task `verify`: whose mark does a suspect carry, of the records that may explain it?

1. Read the suspect.                              3. Report the best, what was checked, and where the mark is.
2. Look for one record's mark after the other.
"""

import time
from dataclasses import dataclass
from pathlib import Path

from engine.flows.records.opened_record import OpenedRecord
from engine.flows.trace.candidates import Outcome
from engine.flows.verify.search import Suspect, VerifyConfig
from engine.present.checks import NO_RECORD, checks_of
from engine.present.wording import recognizes
from engine.usecases.suspect import ReadSuspect
from engine.usecases.verify import VerifyAnswer, VerifyRequest, verify
from engine.watermark.messages import message_hex
from engine.watermark.regions import RegionConfig
from service.problems import Problem
from service.work.candidates import Candidate, load_candidates
from service.work.inputs import load_cameras, load_model, load_pictures
from service.work.pictures import draw_evidence
from service.work.process import Progress, Reply, Request

MOST_OTHERS = 20
"""Assets besides the best one whose readings are returned, at most."""
COULD_NOT_CHECK = "could_not_check"
"""Stands for a verdict where a record could not be opened."""


@dataclass(frozen=True, eq=False)
class Upload:
    """A suspect as a request names it: one model, or pictures."""

    request: Request

    def read(self) -> ReadSuspect:
        """See `engine.usecases.suspect.SuspectSource`."""
        paths = list(self.request.get("images") or ())
        if not paths:
            loaded = load_model(self.request)
            return ReadSuspect(Suspect(loaded.model), loaded.format, loaded.repairs)
        cameras = load_cameras(self.request.get("cameras"), count=len(paths))
        return ReadSuspect(Suspect(None, load_pictures(paths), cameras))


def verify_suspect(request: Request, folder: Path, progress: Progress) -> Reply:
    """Contract: docs/SERVICE.md."""
    began = time.perf_counter()
    if bool(request.get("images")) == (request.get("model") is not None):
        raise Problem("invalid-request", "a suspect is one model, or pictures, not both and not neither")
    verify_request = VerifyRequest(
        suspect=Upload(request),
        candidates=load_candidates(request),
        config=VerifyConfig(
            false_claim_rate=request["false_claim_rate"],
            route=request.get("route") or "auto",
            suspect_seen=request.get("suspect_seen") or "",
            suspect_existed=request.get("suspect_existed") or "",
        ),
        stop_at_first=bool(request.get("stop_at_first")),
        regions=RegionConfig(),
    )

    def report(stage: str, fraction: float) -> None:
        progress("picture" if stage == "locate" else stage, fraction)  # it is there to be drawn

    found = verify(verify_request, report)
    suspect, best = found.read.suspect, found.best
    reply, stages = _report(found), dict(found.seconds_by_stage)
    started = time.perf_counter() - stages.pop("locate", 0.0)
    if found.regions is not None and best is not None and best.opened is not None and best.found is not None:
        reply["regions"] = found.regions.summary()
        reply["files"] = draw_evidence(folder, best.opened, best.found, suspect, found.regions)
    return reply | {
        "subject": {
            "format": found.read.format,
            "gaussians": None if suspect.model is None else len(suspect.model),
            "pictures": len(suspect.pictures),
        },
        "tried": [_brief(outcome) for outcome in found.search.outcomes],
        "others": _others(found),
        "seconds": time.perf_counter() - began,
        "seconds_by_stage": stages | {"picture": time.perf_counter() - started},
    }


def _brief(outcome: Outcome[Candidate]) -> Reply:
    """For the list of all that was tried."""
    claim = outcome.claim
    return {
        "asset": outcome.candidate.asset,
        "verdict": claim.verdict.value if claim is not None else COULD_NOT_CHECK,
        "log10_false_claim": claim.log10_false_claim if claim is not None else None,
        "derived_fraction": claim.derived_fraction if claim is not None else None,
    }


def _others(found: VerifyAnswer[Candidate]) -> list[Reply]:
    """Claims of recognised assets but the best, those first that tell more."""
    others = sorted((each for each in found.search.outcomes if each is not found.best), key=lambda each: each.worth)
    claims = [(each.candidate.asset, each.claim.to_json()) for each in reversed(others) if each.claim is not None]
    return [{"asset": asset, "claim": claim} for asset, claim in claims if recognizes(claim)][:MOST_OTHERS]


def _report(found: VerifyAnswer[Candidate]) -> Reply:
    """The part of the reply about the best candidate."""
    names = ("asset", "claim", "record", "attested", "drawing", "registered_message")
    nothing: Reply = dict.fromkeys(names) | {"files": {}, "regions": None}
    best = found.best
    if best is None:
        return nothing | {"tries": 0, "checks": [NO_RECORD]}
    opened = best.opened
    claim = best.claim.to_json() if best.claim is not None else None
    return nothing | {
        "asset": best.candidate.asset,
        "tries": found.search.tries if best.claim is None else best.claim.tries,
        "claim": claim,
        "checks": checks_of(claim, best.error),
        "record": opened.header.to_json() if opened is not None else None,
        "attested": opened.attested.to_json() if opened is not None and opened.attested is not None else None,
        "drawing": _drawing(opened),
        "registered_message": message_hex(opened.message) if opened is not None else None,
    }


def _drawing(opened: OpenedRecord | None) -> Reply | None:
    """The time stamp that drew for the record, where it counts."""
    if opened is None or opened.attested is None or opened.draw is None or not opened.attested.drawn:
        return None
    return opened.draw.to_json()
