"""Which candidates a suspect is registered to: those whose geometry it resembles, the most alike first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from engine.errors import FormatError, RecordError
from engine.model import GaussianModel
from engine.pipeline.sealing import open_record
from engine.pipeline.verification import VerifyConfig, verify_model
from engine.registration.sketch import ALIKE, Sketch, SuspectIndex
from engine.watermark.claim import Verdict
from service.work.inputs import Candidate
from service.work.process import Progress


@dataclass(frozen=True)
class Ranked:
    """A candidate and how much the suspect resembles it (see `engine.registration.sketch`)."""

    candidate: Candidate
    resemblance: int

    @classmethod
    def unscreened(cls, candidate: Candidate) -> Ranked:
        """One that is looked at in any case."""
        return cls(candidate, ALIKE)

    @property
    def alike(self) -> bool:
        """Whether the suspect may derive from it."""
        return self.resemblance >= ALIKE


def rank(suspect: GaussianModel, candidates: Sequence[Candidate], progress: Progress) -> list[Ranked]:
    """All candidates, the most alike first; equals stay in their order. Chips and keys play no part in it."""
    if not candidates:
        return []
    progress("screen", 0.0)
    index = SuspectIndex(suspect)
    seen: dict[Path, int] = {}
    ranked = []
    for number, candidate in enumerate(candidates, start=1):
        ranked.append(Ranked(candidate, _resemblance(index, candidate, seen)))
        progress("screen", number / len(candidates))
    return sorted(ranked, key=lambda each: -each.resemblance)


def _resemblance(index: SuspectIndex, candidate: Candidate, seen: dict[Path, int]) -> int:
    path = candidate.sketch
    if path is None:
        return ALIKE
    if path not in seen:
        try:
            seen[path] = index.resemblance(Sketch.from_bytes(path.read_bytes()))
        except FormatError:
            seen[path] = ALIKE  # a damaged sketch must not hide an asset
    return seen[path]


def find_marks(model: GaussianModel, candidates: Sequence[Candidate], limit: int, progress: Progress) -> dict[str, Any]:
    """Marks that a model carries already: `{"alike", "screened", "carries"}`, see docs/SERVICE.md.

    Parameters
    ----------
    candidates : sequence of Candidate
        Those that matter most first: at most `limit` of those alike are verified, in this order.
    """
    alike = {each.candidate.asset for each in rank(model, candidates, progress) if each.alike}
    chosen = [candidate for candidate in candidates if candidate.asset in alike][:limit]
    carries = []
    for number, candidate in enumerate(chosen):
        progress("screen", number / len(chosen))
        found = _carries(model, candidate, len(chosen))
        carries += [found] if found is not None else []
    return {"alike": len(alike), "screened": len(chosen), "carries": carries}


def _carries(model: GaussianModel, candidate: Candidate, tries: int) -> dict[str, Any] | None:
    """What the reply says of a candidate whose mark is there.

    The Gaussians alone are read, not renders: a screening must be quick, and a mark that only renders show is
    found by `verify`.
    """
    try:
        opened = open_record(candidate.record.read_bytes(), candidate.key)
    except RecordError:  # its owner learns that when verifying; somebody's upload must not fail for it
        return None
    claim = verify_model(model, opened, VerifyConfig(route="model", tries=tries)).claim
    if claim.verdict is not Verdict.MARKED:
        return None
    return {"asset": candidate.asset, "log10_false_claim": claim.log10_false_claim, "z": claim.z}
