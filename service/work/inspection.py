"""Task `inspect`: what an upload is, and whose mark it already carries."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from engine.cli.models import repair_entries
from engine.errors import RecordError
from engine.model import GaussianModel
from engine.watermark.sketch import make_sketch
from service.work.inputs import Candidate, load_candidates, load_model
from service.work.process import Progress
from service.work.screening import rank

SKETCH = "sketch.bin"


def inspect_upload(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """Contract: docs/SERVICE.md."""
    candidates = load_candidates(request)
    sketch = SKETCH if request.get("sketch") is None else None  # one that was made before is not made again
    progress("read", 0.0)
    loaded = load_model(request)
    model = loaded.model
    ranked = [each for each in rank(model, candidates, progress) if each.alike]
    chosen = [each.candidate for each in ranked[: int(request["limit"])]]
    carries = []
    for number, candidate in enumerate(chosen):
        progress("screen for marks", number / len(chosen))
        found = _carries(model, candidate, len(chosen))
        carries += [found] if found is not None else []
    if sketch is not None:
        progress("sketch", 0.0)
        (folder / sketch).write_bytes(make_sketch(model).to_bytes())
    return {
        "sha256": loaded.sha256,
        "format": loaded.format,
        "bytes": loaded.source_bytes,
        "gaussians": len(model),
        "sh_degree": model.sh_degree,
        "repairs": repair_entries(loaded.repairs),
        "sketch": sketch,
        "alike": len(ranked),
        "screened": len(chosen),
        "carries": carries,
    }


def _carries(model: GaussianModel, candidate: Candidate, tries: int) -> dict[str, Any] | None:
    """What the reply says of a candidate whose mark is there.

    The Gaussians alone are read, not renders: a screening must be quick, and a mark that only renders show is
    found by `verify`.
    """
    # Only here, so that a first look at an upload does not wait for half the engine.
    from engine.pipeline.sealing import open_record
    from engine.pipeline.verification import VerifyConfig, verify_model
    from engine.watermark.claim import Verdict

    try:
        opened = open_record(candidate.record.read_bytes(), candidate.key)
    except RecordError:  # its owner learns that when verifying; somebody's upload must not fail for it
        return None
    claim = verify_model(model, opened, VerifyConfig(route="model", tries=tries)).claim
    if claim.verdict is not Verdict.MARKED:
        return None
    return {"asset": candidate.asset, "log10_false_claim": claim.log10_false_claim, "z": claim.z}
