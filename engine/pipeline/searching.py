"""The search: which record's mark is in this suspect? Hypotheses, tries, routes and ranking, once (DESIGN 4.9).

1. What is asked is fixed, and counted: every record along every route at every place is three tries, walked or not:
   both layers of the mark together and each alone. Of pictures it is six: they are read in two ways.
2. Of many records only those are asked whose asset the suspect resembles (`engine.catalogue`, blind to chips).
3. The suspect is read along a record's routes, the cheapest first, blind to all chips.
4. What a route says is added to what those before it said, never chosen over it.
5. Every reading is judged with all tries counted; the answer that tells most stands first.

Verification asks one record (`verify`), tracing all copies of an asset (`readings`), the service all that is registered
(`search`), the simulator every object of a file (`count_tries`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from engine.errors import InputError, RecordError
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.pipeline.derivation import derivation_of_model, derivation_of_pictures, derivation_of_sight
from engine.pipeline.judging import VerifyConfig, judge
from engine.pipeline.progress import Clock, Progress
from engine.pipeline.reading import read_gaussians, read_pictures, read_renders
from engine.pipeline.sealing import OpenedRecord
from engine.registration.registering import Registration, register
from engine.watermark.claim import Claim, Verdict
from engine.watermark.derivation import Derivation
from engine.watermark.layers import LAYERS
from engine.watermark.model_evidence import Evidence

__all__ = [
    "Candidate",
    "Outcome",
    "Reading",
    "Search",
    "Suspect",
    "Verification",
    "count_tries",
    "readings",
    "search",
    "verify",
]


PICTURE_WAYS = 2
"""Pictures are read with every chip saturated, and by their scatter."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """What is looked at: one model, or pictures of one."""

    model: GaussianModel | None = None
    pictures: Sequence[Float32] = ()  # range 0 to 1; any size, possibly rotated, scaled or cropped
    # One for each picture, where known; found from a record's landmarks otherwise
    cameras: Sequence[Camera] | None = None

    def routes(self, asked: str) -> tuple[str, ...]:
        """The routes along which it is read, in their order.

        InputError if the route takes the other kind of suspect, or the model is empty.
        """
        if self.model is None:
            if asked not in ("auto", "image"):
                raise InputError(f"route {asked!r} takes a model; pictures go by 'image' or 'auto'")
            return ("image",)
        if asked == "image":
            raise InputError("route 'image' takes pictures; a model goes by 'model', 'render' or 'auto'")
        if len(self.model) == 0:
            raise InputError("the suspect model is empty")
        return ("model", "render") if asked == "auto" else (asked,)


@dataclass(frozen=True, eq=False)
class Reading:
    """What a suspect says along one route, blind to all chips."""

    route: str
    evidence: Evidence
    registration: Registration | None  # of a model
    notes: tuple[str, ...]  # for the reader of the claim
    shown: bool  # whether the asset was found in the suspect
    derivation: Derivation  # the same, with how much of it and where
    pictures: Evidence | None = None  # what pictures of it alone say
    scattered: Evidence | None = None  # pictures read by their scatter (`PictureEvidence.by_scatter`)
    cameras: tuple[Camera | None, ...] = ()  # from where each picture shows the reference; None where it was not read

    @property
    def derived_fraction(self) -> float | None:
        """Share of the reference found in the suspect; None where the route does not measure it."""
        return None if self.registration is None else self.registration.derived_fraction


@dataclass(frozen=True, eq=False)
class Verification:
    """A claim, the evidence it rests on, and what it cost."""

    claim: Claim
    evidence: Evidence
    seconds: float
    seconds_by_stage: dict[str, float]
    cameras: tuple[Camera | None, ...] = ()  # of the reading it rests on
    reading: Reading | None = None  # that reading: where it was found, and by what

    def report(self) -> dict[str, Any]:
        """Plain values for `verify --json`."""
        return {**self.claim.to_json(), "seconds": self.seconds, "seconds_by_stage": self.seconds_by_stage}


def count_tries(records: int, routes: Sequence[str], config: VerifyConfig, places: int = 1) -> int:
    """Hypotheses of a question, fixed before any evidence is seen.

    A try is a Z that may be computed: all count from the first on, or the rates of the routes would add up beyond the
    one asked for. A registration's own hypotheses were weighed without the chips and are none.
    """
    ways = sum(PICTURE_WAYS if route == "image" else 1 for route in routes)
    return max(records * ways * len(LAYERS) * places, config.tries or 1)


def readings(
    suspect: Suspect, opened: OpenedRecord, routes: Sequence[str], seed: int, clock: Clock
) -> Iterator[Reading]:
    """Read a suspect against one reference, a route at a time; who has heard enough stops asking.

    The routes are those of `Suspect.routes`, the seed that of the registration's trials.
    """
    if suspect.model is None:
        evidence, scattered, notes, cameras = read_pictures(suspect.pictures, opened, suspect.cameras, clock)
        # Each picture in which the asset was not found left one note that begins so.
        seen = len(suspect.pictures) - sum(note.startswith("picture ") for note in notes)
        sight = derivation_of_pictures(seen, len(suspect.pictures), found=suspect.cameras is None)
        yield Reading("image", evidence, None, notes, bool(evidence.weights.any()), sight, evidence, scattered, cameras)
        return
    with clock.stage("register"):
        registration = register(opened.reference, suspect.model, seed=seed)
        matched = derivation_of_model(opened.reference, suspect.model, registration)
    said: Evidence | None = None
    for route in routes:
        with clock.stage(route):
            if route == "model":
                evidence = read_gaussians(suspect.model, opened, registration)
                said = evidence if evidence.weights.any() else None
                reading = Reading(route, evidence, registration, (), registration.found, matched)
            else:
                renders = read_renders(suspect.model, opened, registration, clock)
                both = said is not None and bool(renders.evidence.weights.any())
                evidence = said.plus(renders.evidence) if said is not None and both else renders.evidence
                sight = derivation_of_sight(matched, renders.recognised)
                asked = "both" if both else route
                said_all = evidence, registration, renders.notes, renders.shown, sight
                reading = Reading(asked, *said_all, renders.evidence)
        yield reading


@one_blas_thread
def verify(
    suspect: Suspect, opened: OpenedRecord, config: VerifyConfig | None = None, progress: Progress | None = None
) -> Verification:
    """Does this suspect carry the record's mark?

    Route "auto" reads a model's Gaussians, and looks at renders of the pose key, too, where these do not show the mark.
    """
    config = config or VerifyConfig()
    clock = Clock(progress)
    routes = suspect.routes(config.route)
    tries = count_tries(1, routes, config)
    best: Verification | None = None
    tried: tuple[str, ...] = ()
    for reading in readings(suspect, opened, routes, config.seed, clock):
        with clock.stage("decide"):
            claim = judge(
                reading.evidence,
                opened,
                reading.route,
                tries,
                config,
                reading.registration,
                reading.notes,
                reading.derivation,
                reading.scattered,
            )
            tried = tuple(dict.fromkeys((*tried, *claim.notes)))
        found = reading.registration is not None and reading.registration.found
        # A model without a Gaussian of the reference may still show the asset: then what it shows decides.
        if best is None or claim.verdict is Verdict.MARKED or reading.route == "both" or (reading.shown and not found):
            best = Verification(claim, reading.evidence, 0.0, {}, reading.cameras, reading)
        if claim.verdict is not Verdict.INCONCLUSIVE and found:  # so near the original, renders show no more
            break
    assert best is not None
    if best.claim.verdict is Verdict.INCONCLUSIVE:  # then all that was tried is worth telling
        best = replace(best, claim=replace(best.claim, notes=tried))
    return replace(best, seconds=clock.total, seconds_by_stage=clock.seconds)


class Candidate(Protocol):
    """A record that may explain a suspect."""

    def open(self) -> OpenedRecord:
        """The record; RecordError where it cannot be used."""


C = TypeVar("C", bound=Candidate)


@dataclass(frozen=True, eq=False)
class Outcome(Generic[C]):
    """What one candidate came to: a verification, or why its record cannot be used."""

    candidate: C
    opened: OpenedRecord | None = None  # kept of the best one only
    found: Verification | None = None
    error: RecordError | None = None

    @property
    def claim(self) -> Claim | None:
        """The claim, where the record could be opened."""
        return self.found.claim if self.found is not None else None

    @property
    def worth(self) -> tuple[float, ...]:
        """Greater tells more: marked, then derived, then undecided, then not to be opened."""
        if (claim := self.claim) is None:
            return (0.0,)
        if claim.verdict is Verdict.MARKED:
            return (4.0, -claim.log10_false_claim)
        if claim.would_be_claim_if_attested:
            return (3.0, -claim.log10_false_claim)
        if claim.derivation.derived:
            return (2.0, claim.derived_fraction or 0.0, -claim.log10_false_claim)
        return (1.0, -claim.log10_false_claim)


@dataclass(frozen=True, eq=False)
class Search(Generic[C]):
    """All that was asked: one outcome for each candidate looked at, in that order, and the tries of the whole."""

    outcomes: tuple[Outcome[C], ...]
    tries: int
    seconds_by_stage: dict[str, float]

    @property
    def best(self) -> Outcome[C] | None:
        """The outcome that tells most, the first among equals; None where nobody was asked."""
        return max(self.outcomes, key=lambda outcome: outcome.worth, default=None)


def search(
    suspect: Suspect, candidates: Sequence[C], config: VerifyConfig, progress: Progress, *, stop_at_first: bool = False
) -> Search[C]:
    """Ask one candidate after the other; with `stop_at_first` none after the first whose mark is there."""
    tries = count_tries(len(candidates), suspect.routes(config.route), config)
    config = replace(config, tries=max(1, tries))
    outcomes: list[Outcome[C]] = []
    seconds: dict[str, float] = {}
    for number, candidate in enumerate(candidates):
        clock = Clock(_share(progress, number, len(candidates)))
        try:
            with clock.stage("open record"):
                opened = candidate.open()
            found = verify(suspect, opened, config, _share(progress, number, len(candidates)))
            outcome = Outcome(candidate, opened, found)
        except RecordError as error:
            outcome = Outcome(candidate, error=error)
        outcomes.append(outcome)
        best = max(outcomes, key=lambda each: each.worth)
        # An opened record holds a whole model: only that of the best answer is kept.
        outcomes = [each if each is best else replace(each, opened=None) for each in outcomes]
        spent = clock.seconds | (outcome.found.seconds_by_stage if outcome.found is not None else {})
        seconds |= {stage: seconds.get(stage, 0.0) + value for stage, value in spent.items()}
        if stop_at_first and outcome.claim is not None and outcome.claim.verdict is Verdict.MARKED:
            break
    return Search(tuple(outcomes), tries, seconds)


def _share(progress: Progress, number: int, count: int) -> Progress:
    """Progress of one candidate; of several, the fraction is over all of them."""
    if count == 1:
        return progress
    return lambda stage, fraction: progress(f"record {number + 1} of {count}", (number + fraction) / count)
