"""The search: is this record's mark in this suspect? Hypotheses, tries and routes, once (DESIGN 4.9).

Routes: `model` (the suspect's Gaussians against the reference's), `render` (the suspect model seen at the pose key
as a black box), `image` (pictures whose camera is known, or found). One decoder reads all evidence.

1. What is tested is fixed, and counted: every record along every route at every place is three tries, walked or not:
   tint and grain together and each alone. Of pictures and of Gaussians it is six: they are read in two ways.
2. Of many records only those are tested whose asset the suspect resembles (`engine.catalogue`, blind to chips).
3. The suspect is read along a record's routes, the cheapest first, blind to all chips.
4. What a route says is added to what those before it said, never chosen over it.
5. Every reading is judged with all tries counted; the answer that says most stands first.
6. The time is limited (`VerifyConfig.time_budget`): it decides whether a whole further step is taken, never what a step
   gives. What was read by then is judged, is never "not marked", and names the budget.

Verification tests one record (`verify`), tracing all copies of an asset (`copies`), the service all that is registered
(`trace.candidates`), the simulator every object of a file (`count_tries`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from engine.errors import InputError
from engine.flows.progress import Clock, Progress
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.decision import Reading, VerifyConfig, judge
from engine.flows.verify.gaussian_evidence import derivation_of_model, read_layers
from engine.formats.cameras.fisheye import without_fisheyes
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.numerics.time_budget import UNLIMITED, TimeBudget
from engine.registration.registration_search import register
from engine.watermark.claim import Claim, Verdict
from engine.watermark.layers import LAYERS
from engine.watermark.model_evidence import Evidence

__all__ = [
    "Answer",
    "Reading",
    "Suspect",
    "Verification",
    "VerifyConfig",
    "count_tries",
    "readings",
    "time_budget",
    "verify",
    "verify_images",
    "verify_model",
]


WAYS = {"image": 2, "model": 2}
"""In how many ways each route is read, where in more than one: pictures with every chip saturated, and by their
scatter; Gaussians with every chip saturated, and in proportion to what each says."""

UNDRAWN = "left out: {} of the suspect model that no viewer draws (opacity below 1/255, or no size)"


@dataclass(frozen=True, eq=False)
class Suspect:
    """What is looked at: one model, or pictures of one."""

    model: GaussianModel | None = None
    pictures: Sequence[Float32] = ()  # range 0 to 1; any size, possibly rotated, scaled or cropped
    # One for each picture, where known; found from a record's landmarks otherwise
    cameras: Sequence[Camera] | None = None

    def __post_init__(self) -> None:
        if self.cameras is not None and len(self.cameras) == len(self.pictures):  # another number is refused later
            pictures, cameras = without_fisheyes(self.pictures, self.cameras)
            object.__setattr__(self, "pictures", pictures)
            object.__setattr__(self, "cameras", cameras)

    def routes(self, wanted: str) -> tuple[str, ...]:
        """The routes along which it is read, in their order.

        InputError if the route takes the other kind of suspect, or the model is empty.
        """
        if self.model is None:
            if wanted not in ("auto", "image"):
                raise InputError(f"route {wanted!r} takes a model; pictures go by 'image' or 'auto'")
            return ("image",)
        if wanted == "image":
            raise InputError("route 'image' takes pictures; a model goes by 'model', 'render' or 'auto'")
        if len(self.model) == 0:
            raise InputError("the suspect model is empty")
        return ("model", "render") if wanted == "auto" else (wanted,)


@dataclass(frozen=True, eq=False)
class Verification:
    """A claim, the evidence it rests on, and what it cost."""

    claim: Claim
    evidence: Evidence
    seconds: float
    seconds_by_stage: dict[str, float]
    cameras: tuple[Camera | None, ...] = ()  # of the reading it rests on
    reading: Reading | None = None  # that reading: where it was found, and by what


def count_tries(records: int, routes: Sequence[str], config: VerifyConfig, places: int = 1) -> int:
    """Hypotheses of a question, fixed before any evidence is seen.

    A try is a Z that may be computed: all count from the first on, or the rates of the routes would add up beyond the
    wanted one. A registration's own hypotheses were weighed without the chips and are none.
    """
    ways = sum(WAYS.get(route, 1) for route in routes)
    return max(records * ways * len(LAYERS) * places, config.tries or 1)


def time_budget(suspect: Suspect, config: VerifyConfig) -> TimeBudget:
    """The time for one record, from now on: of pictures, each adds as much."""
    return TimeBudget(config.time_budget * max(1, len(suspect.pictures)))


def readings(
    suspect: Suspect,
    opened: OpenedRecord,
    routes: Sequence[str],
    seed: int,
    clock: Clock,
    budget: TimeBudget = UNLIMITED,
) -> Iterator[Reading]:
    """Read a suspect against one reference, a route at a time; who has heard enough stops asking.

    The routes are those of `Suspect.routes`, the seed that of the registration's trials. A route that the budget does
    not allow repeats what was read before. Between readings its time stands still.
    """
    for reading in _readings(suspect, opened, routes, seed, clock, budget):
        if budget.left_out:
            reading = replace(reading, notes=(*reading.notes, _ended(budget)), left_out=budget.left_out)
        budget.rest()
        yield reading
        budget.go_on()


def _ended(budget: TimeBudget) -> str:
    return f"the time budget of {budget.seconds:g} s ended the search; left out: {', '.join(budget.left_out)}"


def _counted(gaussians: int) -> str:
    return f"{gaussians:,} Gaussian{'s' if gaussians > 1 else ''}"


def _readings(
    suspect: Suspect, opened: OpenedRecord, routes: Sequence[str], seed: int, clock: Clock, budget: TimeBudget
) -> Iterator[Reading]:
    if suspect.model is None:
        from engine.flows.verify import suspect_evidence as pictures  # and all that reads pictures: slow to load

        known = suspect.cameras
        if known is not None and (origin := opened.origin) is not None:
            known = [camera.relative_to(origin) for camera in known]
        evidence, scattered, notes, cameras = pictures.read_pictures(suspect.pictures, opened, known, clock, budget)
        seen = sum(camera is not None for camera in cameras)
        sight = pictures.derivation_of_pictures(seen, len(suspect.pictures), found=suspect.cameras is None)
        yield Reading(
            "image",
            evidence,
            notes=notes,
            shown=bool(evidence.weights.any()),
            derivation=sight,
            pictures=evidence,
            scattered=scattered,
            cameras=cameras,
            copied=pictures.copy_of_pictures(opened, evidence),
        )
        return
    with clock.stage("register"):
        registration = register(opened.reference, suspect.model, seed=seed, budget=budget)
        matched = derivation_of_model(opened.reference, suspect.model, registration)
    left_out = (UNDRAWN.format(_counted(registration.undrawn)),) if registration.undrawn else ()
    said: Evidence | None = None
    copied: Evidence | None = None
    reading: Reading | None = None
    for route in routes:
        if reading is not None and not budget.allows("renders"):
            yield reading
            continue
        with clock.stage(route):
            if route == "model":
                evidence, copied = read_layers(suspect.model, opened, registration)
                said = evidence if evidence.weights.any() else None
                found = registration.found
                reading = Reading(route, evidence, registration, left_out, found, matched, copied=copied)
            else:
                from engine.flows.verify import suspect_evidence as pictures

                renders = pictures.read_renders(suspect.model, opened, registration, clock, budget)
                both = said is not None and bool(renders.evidence.weights.any())
                evidence = said.plus(renders.evidence) if said is not None and both else renders.evidence
                sight = pictures.derivation_of_sight(matched, renders.recognised)
                along = "both" if both else route
                said_all = evidence, registration, (*left_out, *renders.notes), renders.shown, sight
                shown = pictures.copy_of_pictures(opened, renders.evidence)
                copied = copied.plus(shown) if both and copied is not None and shown is not None else shown
                reading = Reading(along, *said_all, renders.evidence, copied=copied)
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
    answer = Answer(replace(config, tries=count_tries(1, routes, config)))
    for reading in readings(suspect, opened, routes, config.seed, clock, time_budget(suspect, config)):
        with clock.stage("decide"):
            answer.hear(opened, reading)
        if answer.settled:
            break
    return replace(answer.verification, seconds=clock.total, seconds_by_stage=clock.seconds)


class Answer:
    """What one record answers, as one route after the other is heard."""

    def __init__(self, config: VerifyConfig) -> None:
        self._config = config
        self._best: Verification | None = None
        self._notes: tuple[str, ...] = ()
        self.settled = False  # so near the original, further routes show no more

    def hear(self, opened: OpenedRecord, reading: Reading) -> None:
        """Judge what a suspect, read along a route, says of this record's chips."""
        claim = judge(reading, opened, self._config)
        self._notes = tuple(dict.fromkeys((*self._notes, *claim.notes)))
        found = reading.registration is not None and reading.registration.found
        marked = claim.verdict is Verdict.MARKED
        # A model without a Gaussian of the reference may still show the asset: then what it shows decides.
        if self._best is None or marked or reading.route == "both" or (reading.shown and not found):
            self._best = Verification(claim, reading.evidence, 0.0, {}, reading.cameras, reading)
        self.settled = claim.verdict is not Verdict.INCONCLUSIVE and found

    @property
    def verification(self) -> Verification:
        """The best so far; where nothing is decided, with all that was tried."""
        best = self._best
        assert best is not None
        if best.claim.verdict is Verdict.INCONCLUSIVE:
            best = replace(best, claim=replace(best.claim, notes=self._notes))
        return best


def verify_model(
    suspect: GaussianModel, opened: OpenedRecord, config: VerifyConfig | None = None, progress: Progress | None = None
) -> Verification:
    """Does this model carry the record's mark? See `search.verify`."""
    return verify(Suspect(suspect), opened, config, progress)


def verify_images(
    images: Sequence[Float32],
    opened: OpenedRecord,
    config: VerifyConfig | None = None,
    cameras: Sequence[Camera] | None = None,
    progress: Progress | None = None,
) -> Verification:
    """Do these pictures, all together, show a model that carries the record's mark? See `search.Suspect`."""
    return verify(Suspect(None, images, cameras), opened, config, progress)
