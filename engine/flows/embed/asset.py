"""What all copies of an asset share, made once: the model as delivered, its reference, cells, views and landmarks.

A buyer's copy differs by its chips, its message and the cells that its key joins; all that takes long does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from engine.catalogue.entry import SeenPoints, see_points
from engine.flows.embed.auto_profile import Choice
from engine.flows.embed.delivery import Delivery
from engine.flows.embed.landmark_bank import bank_views, make_bank
from engine.flows.embed.layer_strengths import Grained, settle_grain
from engine.flows.embed.planning_basis import Groundwork
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.terms import MarkTerms
from engine.flows.progress import Clock
from engine.flows.records.opened_record import landmarks_in
from engine.flows.views.camera_rig import Extent
from engine.model import GaussianModel
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.records.header import Arrays
from engine.records.record import Record, this_version

__all__ = ["BANK", "Asset", "bank_of", "known_landmarks"]

BANK = 2
"""How a bank is made, as records tell it beside the settings: one more whenever the same settings give another. Records
from before it was counted lack it."""


@dataclass(frozen=True, eq=False)
class Asset:
    """A model made ready to be marked for one recipient after another."""

    original: Groundwork  # of the model as it came
    original_sha256: str  # of the owner's file
    terms: MarkTerms
    settings: EmbedConfig  # the chosen ones, where that was left open
    choice: Choice | None
    delivery: Delivery  # unmarked, as a copy would be delivered
    reference: Arrays  # the delivered model, canonical
    digest: bytes  # of that
    landmarks: Landmarks | None
    seen: SeenPoints | None

    @cached_property
    def grained(self) -> Grained:
        """The second layer at its strength, which no chip decides."""
        return settle_grain(self.delivery.views, self.settings, self.terms.variant)


def bank_of(
    model: GaussianModel, extent: Extent, config: EmbedConfig, clock: Clock, known: Landmarks | None = None
) -> tuple[Landmarks | None, SeenPoints | None]:
    """The bank by which the camera of a screenshot is found, from regular views of the unmarked model; and what an
    index of many assets keeps of it. `known` is the bank, where an earlier copy has it."""
    if config.landmark_views == 0:
        return None, None
    if known is None:
        landmarks, rig = make_bank(model, extent, config.landmark_views, clock.advance)
    else:
        landmarks, rig = known, bank_views(known, model, extent)
    return landmarks, see_points(landmarks, rig)


def known_landmarks(earlier: Record, digest: bytes, config: EmbedConfig) -> Landmarks | None:
    """The bank of an earlier copy's record, where a copy of this reference and these settings would get the same: made
    of the same reference, from as many views, by this version and in this way, which may change before a release."""
    header, told = earlier.header, dict(earlier.extra.get("settings", {}))
    theirs = header.reference_digest, header.tool_version, told.get("landmark_views"), told.get("bank")
    same = theirs == (digest.hex(), this_version(), config.landmark_views, BANK)
    return landmarks_in(earlier.plan_arrays) if same else None
