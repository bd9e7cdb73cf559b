"""What all copies of an asset share, made once: the model as delivered, its reference, cells, views and landmarks.

A buyer's copy differs by its copy layer alone: message, cells and the owner's layer are the asset's.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from engine.catalogue.entry import SeenPoints, see_points
from engine.compress.hvq import Stage, group_means
from engine.flows.embed.auto_profile import Choice
from engine.flows.embed.config import CONFIG
from engine.flows.embed.copy_mark import Committed, OwnerMark, make_owner_mark
from engine.flows.embed.delivery import Delivery
from engine.flows.embed.draws import Draws, shares_layer
from engine.flows.embed.landmark_bank import bank_views, make_bank
from engine.flows.embed.layer_strengths import Fidelity, Grained, settle, settle_grain
from engine.flows.embed.planning_basis import Groundwork
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.terms import MarkTerms
from engine.flows.progress import Clock
from engine.flows.records.opened_record import landmarks_in
from engine.flows.views.camera_rig import Extent
from engine.model import Float64, GaussianModel
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.records.header import Arrays
from engine.records.record import Record
from engine.watermark.keys import OwnerKey
from engine.watermark.lattice import FREE, Lattices, find_lattices
from engine.watermark.masses import find_masses
from engine.watermark.messages import derive_message
from engine.watermark.planning import Plan, make_plan
from engine.watermark.secret_cells import COPIES, OWNER, cells_key, jitter, join_cells, multiples
from engine.watermark.unpredictability import unexplained

__all__ = ["Asset", "bank_of", "known_landmarks"]


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
    key: OwnerKey = field(repr=False)
    copied: bool  # whether its copies differ: a layer of theirs then lies on the owner's

    @cached_property
    def grained(self) -> Grained:
        """The grain at its strength, which no chip decides."""
        return settle_grain(self.delivery.views, self.settings, self.terms.variant, self.lattices)

    @cached_property
    def lattices(self) -> Lattices:
        """On which the values of the unmarked model lie, where Gaussians may be moved one by one."""
        free = self.terms.variant.labels is None and self.settings.output == "fidelity"
        return find_lattices(self.delivery.model) if free else FREE

    @cached_property
    def owner_mark(self) -> OwnerMark:
        """What all copies share, with what their records commit to."""
        terms, settings, ground, views = self.terms, self.settings, self.delivery.ground, self.delivery.views
        settled = settle(views, self._plan(), settings, self.grained)
        message = derive_message(self.key, terms.length, self.digest) if terms.message is None else terms.message
        earlier = terms.earlier
        shared = earlier if earlier is not None and shares_layer(earlier, self.digest, self.key) else None
        draws = Draws(self.original_sha256, terms.stamp, shared)
        commitments = terms.variant.commitments
        committed = Committed(self.digest, message, ground.cameras, self.landmarks, commitments, draws)
        wanted = Fidelity(settings.psnr_db + (CONFIG.strength.copy_margin_db if self.copied else 0.0), settings.ssim)
        at_view = terms.variant.at_view
        pixels = ground.picture_scale
        return make_owner_mark(views, settled, self.key, committed, wanted, pixels, at_view, self.lattices)

    def _plan(self) -> Plan:
        """The tint at unit strength, on cells that the key joins; and the layer in which copies may differ."""
        variant, settings, config = self.terms.variant, self.settings, self.settings.plan
        ground, delivered, stages = self.delivery.ground, self.delivery.model, self.delivery.stages
        # A file's own codebook and the compact output keep few values on purpose: Gaussians move together there, and
        # what many share is no sign of clipping.
        own = variant.labels is not None or settings.paper.public_codes
        free = not own and settings.output == "fidelity"
        still = find_masses(delivered.sh[:, 0], config.mass_share) if free else None
        secret = cells_key(self.key, self.digest, OWNER)
        missed: Float64 | None = None
        times = None if still is None else multiples(secret, still)
        if not own:
            first = self._joined(secret)
            centers = group_means(delivered.means, first.labels, ground.colors).astype(np.float64)
            missed = unexplained(centers, first.codebook[:, :3].astype(np.float64))
            stages = (first, *stages[1:])
        shaken = None if settings.paper.public_codes else lambda chips: jitter(secret, chips)
        emphasis = variant.emphasis_on(ground.impact)
        whole = settings.paper.whole_sh
        plan = make_plan(stages, ground.impact, config, emphasis, missed, shaken, times, whole=whole)
        if not self.copied:
            return plan
        secret = cells_key(self.key, self.digest, COPIES)
        stage = stages[0] if own else self._joined(secret, blurred=still is not None)
        times = None if still is None else multiples(secret, still)
        alone = replace(config, stages=1)
        layer = make_plan(
            (stage,), ground.impact, alone, emphasis, None, lambda chips: jitter(secret, chips), times, whole=whole
        ).layout
        return replace(plan, copies=replace(layer, directions=plan.layout.directions[:1]))

    def _joined(self, secret: bytes, *, blurred: bool = False) -> Stage:
        ground, public, count = self.delivery.ground, self.delivery.stages[0], self.settings.plan.codes
        features, colors = ground.cell_features, ground.colors
        return join_cells(public, features, self.delivery.model, colors, count, secret, blurred=blurred)


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
    """The bank of an earlier copy's record of this reference, made from as many views: copies share it, whatever
    version of the program made it, since the chips that they share follow from it, too."""
    same = earlier.header.reference_digest, dict(earlier.extra.get("settings", {})).get("landmark_views")
    return landmarks_in(earlier.plan_arrays) if same == (digest.hex(), config.landmark_views) else None
