"""What all copies of an asset share, made once: the model as delivered, its reference, cells, views and landmarks.

A buyer's copy differs by its copy layer alone: message, cells and the owner's layer are the asset's.
"""

from dataclasses import dataclass
from functools import cached_property

from engine.flows.embed.auto_profile import Choice
from engine.flows.embed.config import CONFIG
from engine.flows.embed.copy_mark import Committed, OwnerMark, make_owner_mark
from engine.flows.embed.delivery import Delivery
from engine.flows.embed.draft import Draft
from engine.flows.embed.draws import Draws, shares_layer
from engine.flows.embed.landmark_bank import Bank, bank_views, make_bank
from engine.flows.embed.layer_strengths import Fidelity
from engine.flows.embed.planning_basis import Groundwork
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.terms import MarkTerms
from engine.flows.progress import Clock
from engine.flows.records.opened_record import landmarks_in
from engine.flows.views.camera_rig import Extent
from engine.model import GaussianModel
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.records.record import Record
from engine.watermark.messages import derive_message


@dataclass(frozen=True, eq=False)
class Asset:
    """A model made ready to be marked for one recipient after another."""

    original: Groundwork  # of the model as it came
    original_sha256: str  # of the owner's file
    terms: MarkTerms
    settings: EmbedConfig  # the chosen ones, where that was left open
    choice: Choice | None
    draft: Draft
    bank: Bank | None

    @property
    def delivery(self) -> Delivery:
        """Unmarked, as a copy would be delivered."""
        return self.draft.delivery

    @cached_property
    def owner_mark(self) -> OwnerMark:
        """What all copies share, with what their records commit to."""
        terms, settings, draft = self.terms, self.settings, self.draft
        ground, views, digest = self.delivery.ground, self.delivery.views, self.draft.digest
        settled = draft.settle(settings) if self.choice is None else self.choice.settled
        message = derive_message(draft.key, terms.length, digest) if terms.message is None else terms.message
        earlier = terms.earlier
        shared = earlier if earlier is not None and shares_layer(earlier, digest, draft.key) else None
        draws = Draws(self.original_sha256, terms.stamp, shared)
        landmarks, commitments = None if self.bank is None else self.bank.landmarks, terms.variant.commitments
        committed = Committed(digest, message, ground.cameras, landmarks, commitments, draws)
        wanted = Fidelity(settings.psnr_db + (CONFIG.strength.copy_margin_db if draft.copied else 0.0), settings.ssim)
        at_view = terms.variant.at_view
        pixels = ground.picture_scale
        return make_owner_mark(views, settled, draft.key, committed, wanted, pixels, at_view, draft.lattices)


def bank_of(
    model: GaussianModel, extent: Extent, config: EmbedConfig, clock: Clock, known: Landmarks | None = None
) -> Bank | None:
    """The bank, from regular views of the unmarked model. `known` are its landmarks, where an earlier copy has them."""
    if config.landmark_views == 0:
        return None
    if known is not None:
        return Bank(known, bank_views(known, model, extent))
    return Bank(*make_bank(model, extent, config.landmark_views, clock.advance))


def known_landmarks(earlier: Record, digest: bytes, config: EmbedConfig) -> Landmarks | None:
    """The bank of an earlier copy's record of this reference, made from as many views: copies share it, whatever
    version of the program made it, since the chips that they share follow from it, too."""
    same = earlier.header.reference_digest, dict(earlier.extra.get("settings", {})).get("landmark_views")
    return landmarks_in(earlier.plan_arrays) if same == (digest.hex(), config.landmark_views) else None
