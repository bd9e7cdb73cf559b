"""Marking what moves: one record for a whole clip, verified as the 4-D file, as any moment's export, as pictures.

The tint displaces colours that do not change with time, planned on the canonical model (each Gaussian once, where it
is most opaque); what is short-lived carries less. The grain displaces that model's centres and sizes, which go along
at all times. Impact and strength are measured at moments spread over the clip.

**Why verification at a moment stays a theorem (DESIGN 4.9).** A model exported at time t is compared with the
unmarked reference moved to t by the owner's own original. That original is committed to: its digest is part of the
record's plan, and the chips are drawn from a hash of that plan. So the motion cannot be chosen after the chips, and
the moved reference, the matches and the weights know nothing of them. Which moment a suspect shows is chosen by
geometry alone.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol, Self, TypeVar

import numpy as np

from engine.errors import InputError
from engine.flows.embed.embedding import Embedding, embed_on_terms
from engine.flows.embed.profiles import Auto, EmbedConfig
from engine.flows.embed.terms import MarkTerms
from engine.flows.embed.variant import Variant
from engine.flows.progress import Progress
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.decision import VerifyConfig
from engine.flows.verify.gaussian_evidence import derivation_of_model
from engine.flows.verify.search import Verification, count_tries, verify_images, verify_model
from engine.flows.views.camera_rig import GOLDEN_ANGLE, make_rig
from engine.flows.views.config import CONFIG
from engine.model import Camera, Float32, GaussianModel, Int64
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from engine.registration.registration_search import RegistrationConfig, register
from engine.watermark.keys import OwnerKey

__all__ = [
    "Moving",
    "embed_moving",
    "find_time",
    "key_times",
    "move_record",
    "verify_moment",
    "verify_moving_images",
    "visible",
]

FEWEST = 3
"""Visible Gaussians that make a model: fewer span no frame."""

COMMITMENT = "moving"
"""Name under which a record's plan holds the digest of the moving original."""

VISIBLE = 1.0 / 255.0
"""Least opacity that a renderer blends; what lies below at a moment is in no export and no picture of it."""

LEAST_EMPHASIS = 0.2
"""Share of the full displacement that the most short-lived Gaussians still carry."""

TRIED, ROUNDS = 9, 3
"""Moments of the whole clip at which a model is looked for, and how often their distance is then halved."""

BANK_VIEWS = 24
"""Views of the landmarks by which pictures of one moment find their cameras."""


class Moving(Protocol):
    """The same Gaussians over time; `SpacetimeModel` and `FrameSequence` are such."""

    @property
    def span(self) -> tuple[float, float]:
        """First and last moment."""

    def __len__(self) -> int: ...

    def at(self, time: float, displaced: GaussianModel | None = None) -> GaussianModel:
        """All Gaussians at a moment, always the same rows; as if `displaced` were the canonical model, where given."""

    def canonical(self) -> GaussianModel:
        """Each Gaussian where it is most opaque."""

    def persistence(self) -> Float32:
        """(N,) how lasting each Gaussian is, 0 to 1."""

    def displaced(self, canonical: GaussianModel) -> Self:
        """A copy displaced at all times as this canonical model is: its centres, sizes and DC coefficients."""

    def digest(self) -> str:
        """SHA-256 of everything, hexadecimal."""


M = TypeVar("M", bound=Moving)


def key_times(moving: Moving, count: int) -> list[float]:
    """Moments of the key views, spread over the clip so that views next to each other are far apart in time."""
    low, high = moving.span
    turns = (0.5 + GOLDEN_ANGLE / (2 * np.pi) * np.arange(count)) % 1.0
    return [float(low + (high - low) * turn) for turn in turns]


def embed_moving(
    moving: M,
    key: OwnerKey,
    terms: MarkTerms = MarkTerms(),
    *,
    original_sha256: str | None = None,
    copy: str = "",
    progress: Progress | None = None,
) -> tuple[M, Embedding]:
    """Mark a dynamic scene, whose unmarked original the owner keeps for verification.

    `original_sha256` is the digest of the owner's file, by default of the arrays. The landmark bank is left out: a
    canonical model is nothing a picture shows, `move_record` makes one. Errors are those of
    `engine.flows.embed.embedding.embed`. Profile `auto` does not rehearse what moves: see `Auto.unrehearsed`. Returns
    the marked scene, of the same kind, and an embedding whose model is the marked canonical one and whose record
    commits to the original.
    """
    config = terms.config or EmbedConfig()
    if isinstance(config, Auto):
        config = config.unrehearsed
    config = replace(config, landmark_views=0)
    canonical, digest = moving.canonical(), moving.digest()
    times = key_times(moving, config.views)
    variant = Variant(
        at_view=lambda model, k: moving.at(times[k], model),
        emphasis=np.clip(moving.persistence(), LEAST_EMPHASIS, 1.0),
        commitments={COMMITMENT: digest},
    )
    terms = replace(terms, config=config, variant=variant)
    original_sha256 = original_sha256 or digest
    (result,) = embed_on_terms(canonical, key, [copy], terms, original_sha256=original_sha256, progress=progress)
    return moving.displaced(result.model), result


def visible(model: GaussianModel) -> GaussianModel:
    """The Gaussians of a model that a renderer blends at all; InputError where there are fewer than three."""
    return model.take(_visible_rows(model))


def _visible_rows(model: GaussianModel, when: str = "") -> Int64:
    rows = np.flatnonzero(model.opacities >= VISIBLE)
    if len(rows) < FEWEST:
        raise InputError(f"only {len(rows)} of {len(model)} Gaussians are visible{when}")
    return rows


def move_record(opened: OpenedRecord, original: Moving, time: float, *, landmark_views: int = 0) -> OpenedRecord:
    """The record as if the scene had always stood still at one moment: the reference moved, the rest unchanged.

    For `verify_model` and `verify_images`; of the Gaussians that are not visible then, nothing is left.
    `landmark_views` make a bank of that moment, for pictures whose camera is not known. InputError if the record does
    not commit to this very original, or nothing is visible at that moment.
    """
    committed = opened.commitments.get(COMMITMENT)
    if committed is None:
        raise InputError("this record is of a static scene: it commits to no moving original")
    if committed != original.digest():
        raise InputError(f"this is not the original the record commits to: {original.digest()[:16]}... given")
    posed = original.at(time).with_(sh=opened.reference.sh)
    rows = _visible_rows(posed, f" at time {time:g}")
    layout, copies = opened.layout.at(rows), opened.copies and opened.copies.at(rows)
    kept = np.zeros(len(posed), dtype=bool)
    kept[rows] = True
    reference = posed.take(rows)
    landmarks = None
    if landmark_views:
        landmarks = make_landmarks(reference, make_rig(reference, landmark_views, *CONFIG.rig.landmark_size))
    return replace(opened, reference=reference, layout=layout, copies=copies, landmarks=landmarks, kept=kept)


def find_time(suspect: GaussianModel, opened: OpenedRecord, original: Moving, *, seed: int = 0) -> float | None:
    """The moment at which the original looks most like a model exported from it; None where it is never found.

    Most Gaussians nearest to where they should be, in their own sizes. Only geometry and the registration's unmarked
    features decide, so the search adds no hypothesis to a claim. It tries `TRIED` moments over the whole clip, then
    `ROUNDS` times the neighbours of the best.
    """
    shown = visible(suspect)
    rigid = RegistrationConfig(colorless=False, merged=False, deformed=False)  # a wrong moment is to fit badly

    def score(time: float) -> float:
        reference = move_record(opened, original, time).reference
        found = derivation_of_model(reference, shown, register(reference, shown, seed=seed, config=rigid))
        return 0.0 if found.exactness is None else (found.gaussians or 0) / (1.0 + found.exactness**2)

    low, high = original.span
    step = (high - low) / (TRIED - 1)
    scores: dict[float, float] = {float(t): score(float(t)) for t in np.linspace(low, high, TRIED)}
    for _ in range(ROUNDS):
        best = max(scores, key=lambda t: (scores[t], -t))
        if scores[best] == 0.0:
            return None
        step *= 0.5
        scores |= {t: score(t) for t in (best - step, best + step) if low <= t <= high and t not in scores}
    return max(scores, key=lambda t: (scores[t], -t))


def verify_moment(
    suspect: GaussianModel,
    opened: OpenedRecord,
    original: Moving,
    time: float | None = None,
    config: VerifyConfig | None = None,
) -> Verification:
    """Does this model, exported from a scene that moves, carry the mark?

    It is verified against the reference at its moment, looked for (`find_time`) where not given; against the
    canonical one if no moment was found.
    """
    shown = visible(suspect)
    if time is None:
        time = find_time(shown, opened, original, seed=(config or VerifyConfig()).seed)
    return verify_model(shown, opened if time is None else move_record(opened, original, time), config)


def verify_moving_images(
    images: Sequence[Float32],
    opened: OpenedRecord,
    original: Moving,
    times: Sequence[float],
    config: VerifyConfig | None = None,
    cameras: Sequence[Camera] | None = None,
) -> tuple[Verification, float]:
    """Do these pictures (h, w, 3), all of one moment, show the marked scene?

    `times` are the moments it may be; every hypothesis is tested at each, and all are counted. Unknown cameras are
    found by a bank of `BANK_VIEWS`. Returns the best verification and its moment.
    """
    if not times:
        raise InputError("no moment was given")
    config = config or VerifyConfig()
    config = replace(config, tries=count_tries(1, ("image",), config, places=len(times)))
    found: list[tuple[Verification, float]] = []
    for time in times:
        moved = move_record(opened, original, time, landmark_views=0 if cameras else BANK_VIEWS)
        found.append((verify_images(images, moved, config, cameras), time))
    return min(found, key=lambda pair: pair[0].claim.log10_false_claim)
