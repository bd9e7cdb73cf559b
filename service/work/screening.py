"""Which candidates a suspect is registered to: those whose geometry it resembles, the most alike first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from engine.errors import FormatError
from engine.model import GaussianModel
from engine.watermark.sketch import ALIKE, Sketch, SuspectIndex
from service.work.inputs import Candidate
from service.work.process import Progress


@dataclass(frozen=True)
class Ranked:
    """A candidate and how much the suspect resembles it (see `engine.watermark.sketch`)."""

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
