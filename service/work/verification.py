"""Task `verify`: whose mark does a suspect carry, of the records that may explain it?

1. Read the suspect.                              3. Report the best, what was checked, and where the mark is.
2. Look for one record's mark after the other.
"""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from engine.flows.regions.region_search import locate_mark
from engine.flows.trace.candidates import Outcome, Search, search
from engine.flows.verify.search import Suspect
from engine.flows.verify.verification import VerifyConfig
from engine.watermark.checks import NO_RECORD, checks_of
from engine.watermark.messages import message_hex
from service.problems import Problem
from service.work.candidates import Candidate, load_candidates
from service.work.inputs import load_cameras, load_model, load_pictures
from service.work.pictures import draw_evidence
from service.work.process import Progress

COULD_NOT_CHECK = "could_not_check"
"""Stands for a verdict where a record could not be opened."""


def verify_suspect(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """Contract: docs/SERVICE.md."""
    began = time.perf_counter()
    config = VerifyConfig(
        false_claim_rate=request["false_claim_rate"],
        route=request.get("route") or "auto",
        suspect_seen=request.get("suspect_seen") or "",
    )
    candidates = load_candidates(request)
    progress("read", 0.0)
    suspect, subject = _read(request)  # 1
    read = time.perf_counter()
    found = search(suspect, candidates, config, progress, stop_at_first=bool(request.get("stop_at_first")))  # 2
    best = found.best
    reply = _report(found)  # 3
    started = time.perf_counter()
    if best is not None and best.opened is not None and best.found is not None:
        progress("picture", 0.0)
        regions = locate_mark(suspect, best.opened, best.found)
        reply["regions"] = regions.summary()
        reply["files"] = draw_evidence(folder, best.opened, best.found, suspect, regions)
    return reply | {
        "subject": subject,
        "tried": [_brief(outcome) for outcome in found.outcomes],
        "seconds": time.perf_counter() - began,
        "seconds_by_stage": {"read": read - began}
        | found.seconds_by_stage
        | {"picture": time.perf_counter() - started},
    }


def _read(request: Mapping[str, Any]) -> tuple[Suspect, dict[str, Any]]:
    """The suspect, and what is said of it."""
    paths = list(request.get("images") or ())
    if bool(paths) == (request.get("model") is not None):
        raise Problem("invalid-request", "a suspect is one model, or pictures, not both and not neither")
    if not paths:
        loaded = load_model(request)
        return Suspect(loaded.model), {"format": loaded.format, "gaussians": len(loaded.model), "pictures": 0}
    cameras = load_cameras(request.get("cameras"), count=len(paths))
    suspect = Suspect(None, load_pictures(paths), cameras)
    return suspect, {"format": "pictures", "gaussians": None, "pictures": len(suspect.pictures)}


def _brief(outcome: Outcome[Candidate]) -> dict[str, Any]:
    """For the list of all that was tried."""
    claim = outcome.claim
    return {
        "asset": outcome.candidate.asset,
        "verdict": claim.verdict.value if claim is not None else COULD_NOT_CHECK,
        "log10_false_claim": claim.log10_false_claim if claim is not None else None,
        "derived_fraction": claim.derived_fraction if claim is not None else None,
    }


def _report(found: Search[Candidate]) -> dict[str, Any]:
    """The part of the reply that speaks of the best candidate."""
    names = ("asset", "claim", "record", "attested", "registered_message")
    nothing: dict[str, Any] = dict.fromkeys(names) | {"files": {}, "regions": None}
    best = found.best
    if best is None:
        return nothing | {"tries": 0, "checks": [NO_RECORD]}
    opened = best.opened
    claim = best.claim.to_json() if best.claim is not None else None
    return nothing | {
        "asset": best.candidate.asset,
        "tries": found.tries,
        "claim": claim,
        "checks": checks_of(claim, best.error),
        "record": opened.header.to_json() if opened is not None else None,
        "attested": opened.attested.to_json() if opened is not None and opened.attested is not None else None,
        "registered_message": message_hex(opened.message) if opened is not None else None,
    }
