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
from engine.pipeline.reading import read_gaussians, read_pictures, read_renders
from engine.pipeline.sealing import OpenedRecord
from engine.registration.registering import register
from engine.watermark.copies import CopyMark, copies_z, copy_mark
from engine.watermark.model_evidence import Evidence
from engine.watermark.statistics import log10_false_claim_bound, z_threshold

__all__ = ["CopyFinding", "Tracing", "trace_images", "trace_model"]


@dataclass(frozen=True)
class CopyFinding:
    """What the suspect says about one copy.

    Parameters
    ----------
    copy : str
        Name of the recipient.
    named : bool
        The copy took part: its false-claim bound, all tries counted, is at most the rate asked for.
    z : float
        0 expected with a standard deviation of 1 for a copy that took no part.
    log10_false_claim : float
        log10 of that bound.
    route : str
        Kind of evidence.
    derived_fraction : float or None
        Share of the record's reference found in the suspect; None where the route does not measure it.
    """

    copy: str
    record_id: str
    named: bool
    z: float
    log10_false_claim: float
    route: str
    derived_fraction: float | None


@dataclass(frozen=True)
class Tracing:
    """The answer of one tracing.

    Parameters
    ----------
    findings : tuple of CopyFinding
        One for each record, strongest first.
    tries : int
        Hypotheses counted: records times routes.
    z_threshold : float
        The z at which a copy is named.
    false_claim_rate : float
        Largest probability that any innocent copy is named, fixed before the evidence was seen.
    notes : tuple of str
    seconds_by_stage : dict of str to float
    """

    findings: tuple[CopyFinding, ...]
    tries: int
    z_threshold: float
    false_claim_rate: float
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


@one_blas_thread
def trace_model(
    suspect: GaussianModel,
    records: Iterable[OpenedRecord],
    config: VerifyConfig | None = None,
    progress: Progress | None = None,
) -> Tracing:
    """Which of these copies took part in making this model?

    Parameters
    ----------
    records : iterable of OpenedRecord
        Any number; only one of each asset and layout is kept in memory.
    config : VerifyConfig, optional
        Route "auto" reads the Gaussians, and looks at renders of the pose key only where they name nobody.

    Raises
    ------
    InputError
        If there is no record, one is given twice, the suspect is empty, or the route takes pictures.
    """
    config = config or VerifyConfig()
    if config.route == "image":
        raise InputError("route 'image' takes pictures; a model goes by 'model', 'render' or 'auto'")
    if len(suspect) == 0:
        raise InputError("the suspect model is empty")
    clock = Clock(progress)
    with clock.stage("open records"):
        groups = _group(records)  # 1
    routes = ("model", "render") if config.route == "auto" else (config.route,)
    tries = _tries(groups, len(routes), config)  # 2
    findings: list[CopyFinding] = []
    for group in groups:
        with clock.stage("register"):
            registration = register(group.opened.reference, suspect, seed=config.seed)
        best: list[CopyFinding] = []
        for route in routes:
            with clock.stage(route):  # 3
                if route == "model":
                    evidence = read_gaussians(suspect, group.opened, registration)
                else:
                    evidence = read_renders(suspect, group.opened, registration, clock).evidence
                found = _judge(evidence, group, route, tries, config, registration.derived_fraction)  # 4
            if not best or any(finding.named for finding in found):
                best = found
            if any(finding.named for finding in best):
                break
        findings += best
    return _answer(findings, tries, config, (), clock)


@one_blas_thread
def trace_images(
    images: Sequence[Float32],
    records: Iterable[OpenedRecord],
    config: VerifyConfig | None = None,
    cameras: Sequence[Camera] | None = None,
    progress: Progress | None = None,
) -> Tracing:
    """Which of these copies took part in making the model that these pictures show?

    Parameters
    ----------
    images : sequence of (h, w, 3) float32
        Range 0 to 1; any size, possibly rotated, scaled or cropped.
    records : iterable of OpenedRecord
    cameras : sequence of Camera, optional
        One for each picture, where known; found from the landmarks of the records otherwise.

    Returns
    -------
    Tracing
        From all pictures together.

    Raises
    ------
    InputError
        As `trace_model`; also if there is no picture or the cameras are not as many.
    """
    config = config or VerifyConfig()
    if config.route not in ("auto", "image"):
        raise InputError(f"route {config.route!r} takes a model; pictures go by 'image' or 'auto'")
    clock = Clock(progress)
    with clock.stage("open records"):
        groups = _group(records)
    tries = _tries(groups, 1, config)
    findings: list[CopyFinding] = []
    notes: tuple[str, ...] = ()
    for group in groups:
        evidence, unread = read_pictures(images, group.opened, cameras, clock)
        findings += _judge(evidence, group, "image", tries, config, None)
        notes += unread
    return _answer(findings, tries, config, notes, clock)


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


def _tries(groups: Sequence[_Group], routes: int, config: VerifyConfig) -> int:
    return max(routes * sum(len(group.marks) for group in groups), config.tries or 1)


def _judge(
    evidence: Evidence, group: _Group, route: str, tries: int, config: VerifyConfig, derived: float | None
) -> list[CopyFinding]:
    threshold = z_threshold(config.false_claim_rate, tries)
    return [
        CopyFinding(
            mark.copy,
            mark.record_id,
            bool(z >= threshold),
            float(z),
            log10_false_claim_bound(float(z), tries),
            route,
            derived,
        )
        for mark, z in zip(group.marks, copies_z(evidence.y, evidence.weights, group.marks), strict=True)
    ]


def _answer(
    findings: Sequence[CopyFinding], tries: int, config: VerifyConfig, notes: tuple[str, ...], clock: Clock
) -> Tracing:
    strongest_first = tuple(sorted(findings, key=lambda finding: -finding.z))
    threshold = z_threshold(config.false_claim_rate, tries)
    return Tracing(strongest_first, tries, threshold, config.false_claim_rate, notes, clock.total, dict(clock.seconds))
