"""A mark before its strength: what it is planned on, and how strong it may be. No message and no chip is drawn yet.

`auto_profile` rehearses drafts; the embedding goes on from the one that was chosen, so nothing is planned twice.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from engine.compress.hvq import Stage, group_means
from engine.flows.embed.delivery import Delivery
from engine.flows.embed.layer_strengths import Settled, settle, settle_grain
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.variant import Variant
from engine.model import Float64
from engine.records.header import Arrays
from engine.records.reference import encode_reference, reference_digest
from engine.watermark.keys import OwnerKey
from engine.watermark.lattice import FREE, Lattices, find_lattices
from engine.watermark.planning import Plan, make_plan
from engine.watermark.secret_cells import COPIES, OWNER, cells_key, find_masses, jitter, join_cells, multiples
from engine.watermark.unpredictability import unexplained


@dataclass(frozen=True, eq=False)
class Draft:
    """The mark of a model as it would be delivered."""

    delivery: Delivery  # unmarked
    variant: Variant
    key: OwnerKey = field(repr=False)
    copied: bool  # whether its copies differ: a layer of theirs then lies on the owner's

    @cached_property
    def reference(self) -> Arrays:
        """The delivered model, canonical."""
        return encode_reference(self.delivery.model)

    @cached_property
    def digest(self) -> bytes:
        """Of the reference."""
        return reference_digest(self.reference)

    @cached_property
    def lattices(self) -> Lattices:
        """On which the values of the unmarked model lie, where Gaussians may be moved one by one."""
        free = self.variant.labels is None and self.delivery.settings.output == "fidelity"
        return find_lattices(self.delivery.model) if free else FREE

    def settle(self, settings: EmbedConfig) -> Settled:
        """Both layers at the strength that these settings' fidelity allows; the settings differ in that alone."""
        views = self.delivery.views
        return settle(views, self.plan, settings, settle_grain(views, settings, self.variant, self.lattices))

    @cached_property
    def plan(self) -> Plan:
        """The tint at unit strength, on cells that the key joins; and the layer in which copies may differ."""
        variant, settings, config = self.variant, self.delivery.settings, self.delivery.settings.plan
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
        ground, public, count = self.delivery.ground, self.delivery.stages[0], self.delivery.settings.plan.codes
        features, colors = ground.cell_features, ground.colors
        return join_cells(public, features, self.delivery.model, colors, count, secret, blurred=blurred)
