"""The tracing flow: which copies of an asset took part in a suspect? One reading, one Z for every copy.

1. Records are opened one at a time; of each asset one is kept.
2. Each asset is placed in the suspect once, and read along a route, blind to all chips.
3. Every copy's cells are read from that, which gives its Z.
4. Hypotheses are records times routes and layers times two signs. Every copy whose Z passes that bar, one way or the
   other, is named. An asset of which none is named goes on to the next route.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace

from engine.errors import InputError
from engine.flows.progress import Clock, Progress
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.trace.copies import CONFIG, Copies, asset_of
from engine.flows.verify.decision import VerifyConfig, read_copy, strength_left
from engine.flows.verify.search import Suspect, count_tries
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.numerics.plain import Json
from engine.watermark.layers import layered_z
from engine.watermark.rates import BASES, AppliedRate
from engine.watermark.statistics import DISHONEST_CLAIMANT_RATE, log10_false_claim_bound, z_threshold

SIGNS = 2
"""A copy's mark may show turned round."""


@dataclass(frozen=True)
class CopyFinding:
    """What the suspect says about one copy."""

    copy: str  # name of the recipient
    record_id: str
    named: bool  # the copy took part: its false-claim bound, all tries counted, is at most the wanted rate
    # 0 expected with a standard deviation of 1 for a copy that took no part; negative where copies were put together
    # so that what they differ in is turned round
    z: float
    log10_false_claim: float  # log10 of that bound
    route: str  # kind of evidence
    # Share of the record's reference found in the suspect; None where the route does not measure it
    derived_fraction: float | None
    strength: float | None = None  # share of the copy's own layer that is left, of Gaussians: 1 in an untouched copy


@dataclass(frozen=True)
class Tracing:
    """The answer of one tracing."""

    findings: tuple[CopyFinding, ...]  # one for each record, strongest first
    tries: int  # hypotheses counted: records times routes
    z_threshold: float  # the z at which a copy is named
    false_claim_rate: float  # largest probability that any innocent copy is named, fixed before the evidence was seen
    notes: tuple[str, ...]
    seconds: float
    seconds_by_stage: dict[str, float]

    @property
    def named(self) -> tuple[CopyFinding, ...]:
        """The copies that took part."""
        return tuple(finding for finding in self.findings if finding.named)

    def to_json(self) -> Json:
        """Plain dict of JSON values."""
        return {"named": [finding.copy for finding in self.named], **asdict(self)}


def trace_model(
    suspect: GaussianModel,
    records: Iterable[OpenedRecord],
    config: VerifyConfig | None = None,
    progress: Progress | None = None,
) -> Tracing:
    """Which of these copies took part in making this model? See `trace`."""
    return trace(Suspect(suspect), records, config, progress)


def trace_images(
    images: Sequence[Float32],
    records: Iterable[OpenedRecord],
    config: VerifyConfig | None = None,
    cameras: Sequence[Camera] | None = None,
    progress: Progress | None = None,
) -> Tracing:
    """Which of these copies took part in making the model that these pictures, all together, show? See `trace`."""
    return trace(Suspect(None, images, cameras), records, config, progress)


@one_blas_thread
def trace(
    suspect: Suspect,
    records: Iterable[OpenedRecord],
    config: VerifyConfig | None = None,
    progress: Progress | None = None,
) -> Tracing:
    """Which of these copies took part in making this suspect?

    InputError if there is no record, one is given twice, the suspect is empty, or the route takes another kind of
    suspect. Records that can be gone through again, a list or an object that opens files, are opened once for each
    route, and one of each asset is kept in memory. Route "auto" reads a model's Gaussians, and looks at renders of the
    pose key, too, where they name no copy.
    """
    config = config or VerifyConfig()
    clock = Clock(progress)
    routes = suspect.routes(config.route)
    again = list(records) if iter(records) is records else records
    assets: dict[tuple[str, bool, bytes], Copies] = {}
    copies: dict[tuple[str, bool, bytes], list[str]] = {}
    firsts: dict[tuple[str, bool, bytes], OpenedRecord] = {}
    settled: set[tuple[str, bool, bytes]] = set()  # some copy was named: no further route is read
    found: dict[str, CopyFinding] = {}
    demanded: dict[str, AppliedRate] = {}  # of a claim by verification, by record
    tries = 0
    for number in range(len(routes)):
        for opened in _opened(again, clock):  # 1
            record_id = opened.header.record_id
            place = asset_of(opened)
            if place not in assets:
                assets[place], copies[place] = Copies(suspect, opened, routes, config, clock), []
                firsts[place] = opened
            if number == 0:
                if record_id in found:
                    raise InputError(f"record {record_id} (copy {opened.copy!r}) is given twice")
                copies[place].append(record_id)
            if place in settled:
                continue
            assets[place].go_along(number)  # 2
            found[record_id] = judge_copy(assets[place], opened)  # 3
            demanded[record_id] = config.rate_for(opened.attested)
        tries = count_copy_tries(len(found), routes, config)
        found = {name: _counted(finding, tries, config) for name, finding in found.items()}  # 4
        settled = {place for place, names in copies.items() if any(found[name].named for name in names)}
        if len(settled) == len(assets):
            break
    if not found:
        raise InputError("no record was given")
    notes = tuple(note for asset in assets.values() for note in asset.reading.notes)
    for place, names in copies.items():
        notes += tuple(_combined(assets[place], firsts[place], [found[name] for name in names]))
    notes += tuple(_stricter((finding, demanded[name]) for name, finding in found.items() if finding.named))
    strongest_first = tuple(sorted(found.values(), key=lambda finding: -abs(finding.z)))
    threshold = z_threshold(config.false_claim_rate, tries)
    return Tracing(strongest_first, tries, threshold, config.false_claim_rate, notes, clock.total, dict(clock.seconds))


def _opened(records: Iterable[OpenedRecord], clock: Clock) -> Iterator[OpenedRecord]:
    """The records one by one, the time to open them as a stage of its own."""
    left = iter(records)
    while True:
        with clock.stage("open records"):
            opened = next(left, None)
        if opened is None:
            return
        yield opened


def count_copy_tries(records: int, routes: Sequence[str], config: VerifyConfig) -> int:
    """Hypotheses of one tracing among so many records."""
    return max(SIGNS * count_tries(records, routes, replace(config, tries=None)), config.tries or 1)


def judge_copy(asset: Copies, opened: OpenedRecord) -> CopyFinding:
    """What was read of an asset says about one of its copies; tries are not counted yet, and no copy is named."""
    reading = asset.reading
    copy = read_copy(reading, opened, either_way=True)
    if copy is None:  # its mark is its own, or the owner's alone
        evidence = asset.evidence(opened)
        spreading = opened.spreading_of(len(evidence.y))
        signs, sized = spreading.signs(opened.message), evidence.sized(spreading.sizes)
        z, strength = layered_z(sized, signs, opened.layout.chips, either_way=True).best, None
    else:
        z, strength = copy.z, copy.strength if reading.route == "model" else None
    route, share = reading.route, reading.derived_fraction
    return CopyFinding(opened.copy, opened.header.record_id, False, z, 0.0, route, share, strength)


def _combined(asset: Copies, opened: OpenedRecord, findings: Sequence[CopyFinding]) -> Iterator[str]:
    """What the findings about one asset's copies say together."""
    named = [finding for finding in findings if finding.named]
    if len(named) > 1:
        yield f"at least {len(named)} copies were combined: each left its own trace"
    elif named and named[0].strength is not None:
        evidence = asset.reading.evidence
        spreading = opened.spreading_of(len(evidence.y))
        owner = strength_left(evidence.sized(spreading.sizes), spreading.signs(opened.message))
        if owner > 0 and named[0].strength < CONFIG.damped * owner:
            yield "at least two copies were combined: what tells this copy from others is damped"


def _stricter(named: Iterable[tuple[CopyFinding, AppliedRate]]) -> Iterator[str]:
    """Why verification may leave open what is named here, from each named copy and the rate of a claim about it."""
    limit = math.log10(DISHONEST_CLAIMANT_RATE)
    applied = [each for finding, each in named if finding.log10_false_claim > max(math.log10(each.rate), limit)]
    if applied:
        why = " or ".join(dict.fromkeys(BASES[each.basis] for each in applied))
        yield (
            "a copy is named among the owner's own records, against chance alone; that the asset is the owner's is for"
            f" verify to claim, which requires 1 in 2^128 here: {why}"
        )


def _counted(finding: CopyFinding, tries: int, config: VerifyConfig) -> CopyFinding:
    """The finding with its bound, now that all tries are known; their number does not depend on what was read."""
    z = abs(finding.z)
    named = z >= z_threshold(config.false_claim_rate, tries)
    return replace(finding, named=named, log10_false_claim=log10_false_claim_bound(z, tries))
