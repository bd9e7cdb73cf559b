"""Of many records, whose mark is in this suspect? Copies of one asset share a reading.

1. Records are tested one asset after the other, in the order in which they come; all count as tries.
2. A record by itself is verified. Of several copies each is judged along the cheapest route, then, where none is
   marked, along the next one.
3. Pictures say less of a copy that is read as another one: copies that stand out are verified by themselves.
4. The answer that says most stands first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Generic, Protocol, TypeVar

from engine.errors import RecordError
from engine.flows.progress import Clock, Progress
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.trace.copies import CONFIG, Copies, asset_of
from engine.flows.verify.decision import VerifyConfig
from engine.flows.verify.search import Answer, Suspect, Verification, count_tries, verify
from engine.numerics.blas import one_blas_thread
from engine.watermark.claim import Claim, Verdict


class Candidate(Protocol):
    """A record that may explain a suspect."""

    @property
    def original(self) -> str:
        """Digest of what was marked: those of one original that follow one another share a reading where they can."""

    def open(self) -> OpenedRecord:
        """The record; RecordError where it cannot be used."""


C = TypeVar("C", bound=Candidate)


@dataclass(frozen=True, eq=False)
class Outcome(Generic[C]):
    """What one candidate came to: a claim, or why its record cannot be used."""

    candidate: C
    claim: Claim | None = None
    error: RecordError | None = None
    whole: bool = True  # False where it was read as another copy, so that pictures may tell more
    opened: OpenedRecord | None = None  # of the best one only, like the next: they hold a whole model
    found: Verification | None = None

    @property
    def marked(self) -> bool:
        """Whether its mark is there."""
        return self.claim is not None and self.claim.verdict is Verdict.MARKED

    @property
    def named(self) -> bool:
        """Whether it is this copy, as far as copies of its kind differ by themselves."""
        return self.marked and self.claim is not None and self.claim.copy_named is not False

    @property
    def z(self) -> float:
        """How loudly the suspect speaks for it; 0 where it could not be tested."""
        return 0.0 if self.claim is None else self.claim.z

    @property
    def worth(self) -> tuple[float, ...]:
        """Greater says more: marked, then derived, then undecided, then not read in full, then not to be opened."""
        if (claim := self.claim) is None:
            return (0.0,)
        if not self.whole:
            return (0.5,)
        if self.marked:
            return (4.0, claim.copy_z or 0.0, -claim.log10_false_claim)
        if claim.would_be_claim_if_attested:
            return (3.0, -claim.log10_false_claim)
        if claim.derivation.derived:
            return (2.0, claim.derived_fraction or 0.0, -claim.log10_false_claim)
        return (1.0, -claim.log10_false_claim)


@dataclass(frozen=True, eq=False)
class Search(Generic[C]):
    """All that was tested: one outcome for each candidate looked at, in that order, and the tries of the whole."""

    outcomes: tuple[Outcome[C], ...]
    tries: int
    seconds_by_stage: dict[str, float]

    @property
    def best(self) -> Outcome[C] | None:
        """The outcome that says most, the first among equals; None where there is none."""
        return max(self.outcomes, key=lambda outcome: outcome.worth, default=None)


@one_blas_thread
def search(
    suspect: Suspect, candidates: Sequence[C], config: VerifyConfig, progress: Progress, *, stop_at_first: bool = False
) -> Search[C]:
    """Test one candidate after the other; with `stop_at_first` none after the first copy that is named."""
    tries = count_tries(len(candidates), suspect.routes(config.route), config)
    tests = _Tests(suspect, replace(config, tries=max(1, tries)), progress, len(candidates), stop_at_first)
    outcomes: list[Outcome[C]] = []
    for _, copies in groupby(candidates, lambda each: each.original):
        outcomes = _with_best(outcomes + tests.about(list(copies)))
        if stop_at_first and any(each.named for each in outcomes):
            break
    return Search(tuple(outcomes), tries, tests.seconds)


def _with_best(outcomes: Sequence[Outcome[C]]) -> list[Outcome[C]]:
    """The outcomes, of which the best alone keeps its record and what was found."""
    best = max(outcomes, key=lambda each: each.worth)
    keep = [each is best or each.opened is None for each in outcomes]
    return [each if kept else replace(each, opened=None, found=None) for each, kept in zip(outcomes, keep, strict=True)]


class _Tests:
    """Tests of one asset after the other."""

    def __init__(
        self, suspect: Suspect, config: VerifyConfig, progress: Progress, count: int, stop_at_first: bool
    ) -> None:
        self._suspect, self._config, self._stop_at_first = suspect, config, stop_at_first
        self._progress, self._count, self._done, self._number = progress, count, 0, 0
        self._clock = Clock(self._tell)

    @property
    def seconds(self) -> dict[str, float]:
        """By stage."""
        return self._clock.seconds

    def about(self, copies: Sequence[C]) -> list[Outcome[C]]:
        """One outcome for each copy of an asset; with `stop_at_first` none behind the first whose mark is there."""
        outcomes = self._together(copies) if len(copies) > 1 else [self._alone(copies[0])]
        loud = [number for number, each in enumerate(outcomes) if not each.whole and each.z >= CONFIG.stands_out]
        for number in sorted(loud, key=lambda number: -outcomes[number].z):
            outcomes[number] = self._alone(copies[number])
            if self._stop_at_first and outcomes[number].named:
                break
        self._done, self._number = self._done + len(copies), 0
        return outcomes

    def _alone(self, candidate: C) -> Outcome[C]:
        opened = self._open(candidate)
        if isinstance(opened, RecordError):
            return Outcome(candidate, error=opened)
        found = verify(self._suspect, opened, self._config, self._tell)
        for stage, seconds in found.seconds_by_stage.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds
        return Outcome(candidate, found.claim, opened=opened, found=found)

    def _together(self, copies: Sequence[C]) -> list[Outcome[C]]:
        """Read along one route after the other until a mark is there; records are opened anew for each."""
        outcomes: list[Outcome[C]] = []
        placed: dict[tuple[str, bool, bytes], tuple[Copies, Answer]] = {}
        unsettled = list(range(len(copies)))
        for route in range(len(self._suspect.routes(self._config.route))):
            going_on = []
            for number in unsettled:
                self._number = number
                outcome, settled = self._along(route, copies[number], placed)
                if outcome.marked and not outcome.whole:
                    outcome = self._alone(copies[number])
                outcomes = _with_best([*outcomes[:number], outcome, *outcomes[number + 1 :]])
                if self._stop_at_first and outcome.named:
                    return outcomes
                if not settled:
                    going_on.append(number)
            if any(each.marked for each in outcomes):
                break
            unsettled = going_on
        return outcomes

    def _along(
        self, route: int, candidate: C, placed: dict[tuple[str, bool, bytes], tuple[Copies, Answer]]
    ) -> tuple[Outcome[C], bool]:
        """One copy along one route, and whether further ones say no more of it."""
        opened = self._open(candidate)
        if isinstance(opened, RecordError):
            return Outcome(candidate, error=opened), True
        place = asset_of(opened)
        if place not in placed:
            routes = self._suspect.routes(self._config.route)
            read = Copies(self._suspect, opened, routes, self._config, self._clock)
            placed[place] = read, Answer(self._config)
        read, answer = placed[place]
        read.go_along(route)
        itself = opened.header.record_id == read.read_as
        with self._clock.stage("decide"):
            answer = answer if itself else Answer(self._config)
            answer.hear(opened, read.reading if itself else read.reading_of(opened))
        shared = opened.spreading.sizes is not None  # one reading is that of all copies
        found, whole = answer.verification, itself or shared or read.reading.route == "model"
        return Outcome(candidate, found.claim, None, whole, opened, found), answer.settled

    def _open(self, candidate: C) -> OpenedRecord | RecordError:
        with self._clock.stage("open record"):
            try:
                return candidate.open()
            except RecordError as error:
                return error

    def _tell(self, stage: str, fraction: float) -> None:
        """Of several candidates, the fraction is over all of them."""
        if self._count == 1:
            self._progress(stage, fraction)
        else:
            number = self._done + self._number
            self._progress(f"record {number + 1} of {self._count}", (number + fraction) / self._count)
