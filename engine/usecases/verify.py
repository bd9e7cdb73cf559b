"""Verify a suspect: of the records that may explain it, whose mark does it carry, and where?"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from engine.errors import InputError
from engine.numerics.plain import Json, Report
from engine.usecases.read_ahead import ahead

if TYPE_CHECKING:
    from engine.flows.progress import Progress
    from engine.flows.records.opened_record import OpenedRecord
    from engine.flows.regions.region_search import RegionReport
    from engine.flows.trace.candidates import Candidate, Outcome, Search
    from engine.flows.verify.decision import VerifyConfig
    from engine.flows.verify.search import Suspect, Verification
    from engine.usecases.suspect import ReadSuspect, SuspectSource
    from engine.watermark.claim import Claim
    from engine.watermark.rates import Attested
    from engine.watermark.regions import RegionConfig

__all__ = ["VerifyAnswer", "VerifyReport", "VerifyRequest", "printed", "verify"]

MOMENTS = 9
"""Moments of a clip that pictures are compared with; each is a hypothesis."""

C = TypeVar("C", bound="Candidate")


@dataclass(frozen=True, eq=False, kw_only=True)
class VerifyRequest(Generic[C]):
    """What is looked for, and where; InputError where the parts do not go together."""

    suspect: SuspectSource
    candidates: Sequence[C]  # records that may explain the suspect, in the order in which they are compared
    config: VerifyConfig
    stop_at_first: bool = False  # whether none is compared after the first whose mark is there
    # Unmarked clip, of the one record of a scene that moves: the suspect is compared with moments of it
    original: Path | None = None
    regions: RegionConfig | None = None  # where the best candidate's mark is located, too

    def __post_init__(self) -> None:
        if self.original is not None and self.regions is not None:
            raise InputError("regions are only located in a static scene: give no original")
        if self.original is not None and len(self.candidates) != 1:
            raise InputError(f"an original belongs to one record, got {len(self.candidates)}")


@dataclass(frozen=True, eq=False)
class VerifyReport(Report):
    """A claim, and the record it is about."""

    inlined = "claim"

    claim: Claim
    seconds: float
    seconds_by_stage: dict[str, float]
    record_id: str
    owner: str
    registered_at: str
    attested: Attested | None
    original_sha256: str

    @classmethod
    def of(cls, found: Verification, opened: OpenedRecord) -> VerifyReport:
        """The report on one record."""
        header = opened.header
        return cls(
            claim=found.claim,
            seconds=found.seconds,
            seconds_by_stage=found.seconds_by_stage,
            record_id=header.record_id,
            owner=header.owner,
            registered_at=header.registered_at,
            attested=opened.attested,
            original_sha256=header.original_digest,
        )


def printed(report: Json, registered: str) -> Json:
    """The JSON of a `VerifyReport` as it is returned: its `Reading` in place of those members, and the rest."""
    from engine.present.reading import reading_of

    reading = reading_of(report, registered).to_json()
    said = {*reading, "message", "matching_bits", "bit_reliability", "tries"}
    return reading | {name: value for name, value in report.items() if name not in said}


@dataclass(frozen=True, eq=False)
class VerifyAnswer(Generic[C]):
    """The result of a verification."""

    read: ReadSuspect
    search: Search[C]
    regions: RegionReport | None  # of the best candidate, where requested and its record could be opened
    seconds_by_stage: dict[str, float]

    @property
    def best(self) -> Outcome[C] | None:
        """The candidate with the strongest evidence; None where there was none."""
        return self.search.best


def verify(
    request: VerifyRequest[C], progress: Progress, prepare: Callable[[ReadSuspect], None] | None = None
) -> VerifyAnswer[C]:
    """Read the suspect, look for one record's mark after the other, and locate the best one's where requested.

    Raises the errors of reading the suspect's files; what is wrong with a record stands in its outcome.

    Parameters
    ----------
    prepare : callable, optional
        Called with the suspect once it is read, before the work on it.
    """
    reading = ahead(request.suspect.read)
    from engine.flows.trace.candidates import search  # while the files are read

    began = time.perf_counter()
    progress("read", 0.0)
    read = reading.result()
    stages = {"read": time.perf_counter() - began}
    if prepare is not None:
        prepare(read)
    found = _search_moments(request, read) if request.original is not None else None
    if found is None:
        config, first = request.config, request.stop_at_first
        found = search(read.suspect, request.candidates, config, progress, stop_at_first=first)
    stages |= found.seconds_by_stage
    best, regions = found.best, None
    if request.regions is not None and best is not None and best.opened is not None and best.found is not None:
        started = time.perf_counter()
        progress("locate", 0.0)
        from engine.flows.regions.region_search import locate_mark

        regions = locate_mark(read.suspect, best.opened, best.found, request.regions)
        stages["locate"] = time.perf_counter() - started
    return VerifyAnswer(read, found, regions, stages)


def _search_moments(request: VerifyRequest[C], read: ReadSuspect) -> Search[C] | None:
    """The one record compared with moments of its clip; None where the suspect is a clip itself."""
    from engine.flows.trace.candidates import Outcome, Search
    from engine.scenes.scene_files import CLIPS

    if request.original is None or read.format in CLIPS:
        return None
    (candidate,) = request.candidates
    opened = candidate.open()
    found = verify_in_motion(read.suspect, opened, request.original, request.config)
    outcome = Outcome(candidate, found.claim, opened=opened, found=found)
    return Search((outcome,), found.claim.tries, found.seconds_by_stage)


def verify_in_motion(suspect: Suspect, opened: OpenedRecord, original: Path, config: VerifyConfig) -> Verification:
    """Does this model, exported from a clip, or do these pictures of one moment of it, carry the mark?

    `original` is the file or the folder of the unmarked clip that the record commits to; InputError if it is another,
    or none. Each moment that pictures are compared with is a hypothesis; which moment a model shows is found from its
    geometry alone.
    """
    import numpy as np

    from engine.model import GaussianModel
    from engine.scenes.clip_marking import verify_moment, verify_moving_images
    from engine.scenes.codebook_model import CodebookModel
    from engine.scenes.scene_files import read_scene

    loaded = read_scene(original)
    if isinstance(loaded.scene, GaussianModel | CodebookModel):
        raise InputError(f"{original}: is no clip that moves ({loaded.format})")
    if suspect.model is not None:
        return verify_moment(suspect.model, opened, loaded.scene, config=config)
    times = np.linspace(*loaded.scene.span, MOMENTS).tolist()
    return verify_moving_images(suspect.pictures, opened, loaded.scene, times, config, suspect.cameras)[0]
