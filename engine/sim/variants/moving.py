"""Marking what moves: one record for a whole clip, verified as the 4-D file, as any moment's export, as pictures.

The mark displaces colours that do not change with time, planned on the canonical model (each Gaussian once, where it
is most opaque); what is short-lived carries less; impact and strength are measured at moments spread over the clip.

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
from engine.model import Camera, Float32, GaussianModel
from engine.pictures.landmarks import make_landmarks
from engine.pipeline.embedding import LANDMARK_SIZE, Embedding, embed
from engine.pipeline.profiles import EmbedConfig
from engine.pipeline.progress import Progress
from engine.pipeline.rigs import GOLDEN_ANGLE, make_rig
from engine.pipeline.sealing import OpenedRecord
from engine.pipeline.variant import Variant
from engine.watermark.keys import OwnerKey
from engine.watermark.layout import Layout
from engine.watermark.messages import Signs

__all__ = ["Moving", "embed_moving", "key_times", "move_record", "visible"]

COMMITMENT = "moving"
"""Name under which a record's plan holds the digest of the moving original."""

VISIBLE = 1.0 / 255.0
"""Least opacity that a renderer blends; what lies below at a moment is in no export and no picture of it."""

LEAST_EMPHASIS = 0.2
"""Share of the full displacement that the most short-lived Gaussians still carry."""


class Moving(Protocol):
    """The same Gaussians over time; `SpacetimeModel` and `FrameSequence` are such."""

    @property
    def span(self) -> tuple[float, float]:
        """First and last moment."""

    def __len__(self) -> int: ...

    def at(self, time: float) -> GaussianModel:
        """All Gaussians at a moment, always the same rows."""

    def canonical(self) -> GaussianModel:
        """Each Gaussian where it is most opaque."""

    def persistence(self) -> Float32:
        """(N,) how lasting each Gaussian is, 0 to 1."""

    def displaced(self, dc: Float32) -> Self:
        """A copy with the DC coefficients moved by (N, 3), at all times."""

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
    *,
    original_sha256: str | None = None,
    message: Signs | None = None,
    bits: int = 32,
    config: EmbedConfig | None = None,
    cameras: Sequence[Camera] | None = None,
    copy: str = "",
    registered_at: str = "",
    progress: Progress | None = None,
) -> tuple[M, Embedding]:
    """Mark a dynamic scene.

    Parameters
    ----------
    moving : Moving
        The unmarked original; the owner keeps it for verification.
    original_sha256 : str, optional
        Digest of the owner's file; that of the arrays where not given.
    message, bits, cameras, copy, registered_at, progress
        As for `engine.pipeline.embedding.embed`.
    config : EmbedConfig, optional
        The landmark bank is left out: a canonical model is nothing a picture shows. `move_record` makes one.

    Returns
    -------
    marked : Moving
        Of the same kind.
    embedding : Embedding
        Its model is the marked canonical one; its record commits to the original.

    Raises
    ------
    CapacityError, InputError
        As `embed`.
    """
    config = replace(config or EmbedConfig(), landmark_views=0)
    canonical = moving.canonical()
    times = key_times(moving, config.views)
    digest = moving.digest()
    variant = Variant(
        at_view=lambda model, k: moving.at(times[k]).with_(sh=model.sh),
        emphasis=np.clip(moving.persistence(), LEAST_EMPHASIS, 1.0),
        commitments={COMMITMENT: digest},
    )
    result = embed(
        canonical,
        key,
        original_sha256=original_sha256 or digest,
        message=message,
        bits=bits,
        config=config,
        cameras=cameras,
        copy=copy,
        registered_at=registered_at,
        progress=progress,
        variant=variant,
    )
    return moving.displaced(result.model.sh[:, 0] - canonical.sh[:, 0]), result


def visible(model: GaussianModel) -> GaussianModel:
    """The Gaussians of a model that a renderer blends at all; InputError where there are fewer than three."""
    rows = np.flatnonzero(model.opacities >= VISIBLE)
    if len(rows) < 3:
        raise InputError(f"only {len(rows)} of {len(model)} Gaussians are visible")
    return model.take(rows)


def move_record(opened: OpenedRecord, original: Moving, time: float, *, landmark_views: int = 0) -> OpenedRecord:
    """The record as if the scene had always stood still at one moment: the reference moved, the rest as it is.

    Parameters
    ----------
    opened : OpenedRecord
        Of `embed_moving`.
    original : Moving
        The very original that was marked.
    landmark_views : int
        Views of a landmark bank of that moment, for pictures whose camera is not known; 0 makes none.

    Returns
    -------
    OpenedRecord
        For `verify_model` and `verify_images`. Of the Gaussians that are not visible then, nothing is left.

    Raises
    ------
    InputError
        If the record does not commit to this original, or nothing is visible at that moment.
    """
    committed = opened.commitments.get(COMMITMENT)
    if committed is None:
        raise InputError("this record is of a scene that stands still: it commits to no moving original")
    if committed != original.digest():
        raise InputError(f"this is not the original the record commits to: {original.digest()[:16]}... given")
    posed = original.at(time).with_(sh=opened.reference.sh)
    rows = np.flatnonzero(posed.opacities >= VISIBLE)
    if len(rows) < 3:
        raise InputError(f"only {len(rows)} Gaussians are visible at time {time:g}")
    layout = Layout(
        tuple(np.ascontiguousarray(labels[rows]) for labels in opened.layout.labels),
        opened.layout.codes,
        opened.layout.directions,
        opened.layout.amplitudes,
    )
    reference = posed.take(rows)
    landmarks = None
    if landmark_views:
        landmarks = make_landmarks(reference, make_rig(reference, landmark_views, *LANDMARK_SIZE))
    return replace(opened, reference=reference, layout=layout, landmarks=landmarks)
