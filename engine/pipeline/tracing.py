"""The tracing flow: which copies of an asset took part in a suspect? One reading, one Z for every copy.

1. Records are put together by asset and layout; of each group one is kept whole, of the others only the signs.
2. The number of hypotheses (records times routes) and with it the bar are fixed before the suspect is read.
3. Each group is read once along a route, blind to all chips.
4. Every copy whose Z passes the bar is named. A group in which none is named goes on to the next route.
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.pipeline.judging import VerifyConfig
from engine.pipeline.progress import Clock, Progress
from engine.pipeline.sealing import OpenedRecord
from engine.pipeline.searching import Reading, Suspect, count_tries, readings
from engine.watermark.copies import CopyMark, copies_z, copy_mark
from engine.watermark.statistics import log10_false_claim_bound, z_threshold

__all__ = ["CopyFinding", "Tracing", "trace", "trace_images", "trace_model"]


@dataclass(frozen=True)
class CopyFinding:
    """What the suspect says about one copy."""

    copy: str  # name of the recipient
    record_id: str
    named: bool  # the copy took part: its false-claim bound, all tries counted, is at most the rate asked for
    z: float  # 0 expected with a standard deviation of 1 for a copy that took no part
    log10_false_claim: float  # log10 of that bound
    route: str  # kind of evidence
    # Share of the record's reference found in the suspect; None where the route does not measure it
    derived_fraction: float | None


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

    def to_json(self) -> dict[str, Any]:
        """Plain dict of JSON values."""
        return {"named": [finding.copy for finding in self.named], **asdict(self)}


@dataclass(eq=False)
class _Group:
    """Copies that share reference, code vectors, carriers and amplitudes: one reading serves all."""

    opened: OpenedRecord
    marks: list[CopyMark] = field(default_factory=list)


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
    suspect. Of any number of records only one of each asset and layout is kept in memory. Route "auto" reads a model's
    Gaussians, and looks at renders of the pose key only where they name nobody.
    """
    config = config or VerifyConfig()
    clock = Clock(progress)
    routes = suspect.routes(config.route)
    with clock.stage("open records"):
        groups = _group(records)  # 1
    tries = count_tries(sum(len(group.marks) for group in groups), routes, config)  # 2
    findings: list[CopyFinding] = []
    notes: tuple[str, ...] = ()
    for group in groups:
        best: list[CopyFinding] = []
        for reading in readings(suspect, group.opened, routes, config.seed, clock):  # 3
            found = _judge(reading, group, tries, config)  # 4
            notes += reading.notes
            named = any(finding.named for finding in found)
            if not best or named:
                best = found
            if named:
                break
        findings += best
    strongest_first = tuple(sorted(findings, key=lambda finding: -finding.z))
    threshold = z_threshold(config.false_claim_rate, tries)
    return Tracing(strongest_first, tries, threshold, config.false_claim_rate, notes, clock.total, dict(clock.seconds))


def _group(records: Iterable[OpenedRecord]) -> list[_Group]:
    groups: dict[bytes, _Group] = {}
    seen: set[str] = set()
    for opened in records:
        record_id = opened.header.record_id
        if record_id in seen:
            raise InputError(f"record {record_id} (copy {opened.copy!r}) is given twice")
        seen.add(record_id)
        group = groups.setdefault(_layout_digest(opened), _Group(opened))
        group.marks.append(copy_mark(record_id, opened.copy, opened.spreading, opened.message))
    if not groups:
        raise InputError("no record was given")
    return list(groups.values())


def _layout_digest(opened: OpenedRecord) -> bytes:
    """Digest of what a reading depends on: reference, code vectors, carriers, amplitudes."""
    layout, digest = opened.layout, hashlib.sha256(bytes.fromhex(opened.header.reference_digest))
    arrays: list[npt.NDArray[Any]] = [*layout.labels, *layout.directions, layout.amplitudes]
    for array in arrays:
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.digest()


def _judge(reading: Reading, group: _Group, tries: int, config: VerifyConfig) -> list[CopyFinding]:
    threshold = z_threshold(config.false_claim_rate, tries)
    z_of_each = copies_z(reading.evidence.y, reading.evidence.weights, group.marks)
    return [
        CopyFinding(
            mark.copy,
            mark.record_id,
            bool(z >= threshold),
            float(z),
            log10_false_claim_bound(float(z), tries),
            reading.route,
            reading.derived_fraction,
        )
        for mark, z in zip(group.marks, z_of_each, strict=True)
    ]
