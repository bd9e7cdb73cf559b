"""One mark: bits and chips drawn from the key for a settled plan, put into the model, and looked at.

1. The owner's layer, which all copies share: where its own chips show more than the public ones did, the plan is made
   weaker, which draws others.
2. The layer of one copy, on top. Where it shows too much it is drawn anew, never made weaker: a strength of a copy's
   own would give its values away to anyone who compares copies.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from engine.flows.embed.config import CONFIG
from engine.flows.embed.draws import Draws
from engine.flows.embed.layer_strengths import Fidelity, Settled, add_dc, measure
from engine.flows.embed.variant import AtView
from engine.flows.records.draw import DRAWN
from engine.flows.records.opened_record import (
    Drawn,
    Layers,
    OpenedRecord,
    draw_copy,
    draw_owner,
    owner_displacements,
    plan_of,
)
from engine.flows.views.view_set import ViewSet
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.records.record import Plan
from engine.watermark.copy_layer import CopyLayer
from engine.watermark.grain import ATTRIBUTES, Grain, roughen
from engine.watermark.keys import OwnerKey
from engine.watermark.lattice import FREE, Lattices
from engine.watermark.messages import Signs
from engine.watermark.planning import capacity_bits, check_capacity, grain_capacity
from engine.watermark.spreading import ONE_BIT, public_values, spread_grain


@dataclass(frozen=True, eq=False)
class Committed:
    """What the records of all copies commit to in addition to the plan."""

    asset: bytes  # digest of the canonical reference
    message: Signs
    cameras: Sequence[Camera]
    landmarks: Landmarks | None
    commitments: Mapping[str, str] = field(default_factory=dict)
    draws: Draws | None = None  # by whom a part of each plan is drawn
    stamps: tuple[bytes, ...] = ()  # time stamps by which it was, of the plans so far; the last is this one's

    def drawn_for(self, key: OwnerKey, model: GaussianModel, settled: Settled) -> "Committed":
        """With what is drawn for this plan, in place of what was for another."""
        if self.draws is None:
            return self
        drawn, stamp = self.draws.draw(key, self.asset, self.plan(model, settled))
        others = {name: text for name, text in self.commitments.items() if name != DRAWN}
        stamps = self.stamps if stamp is None else (*self.stamps, stamp)
        return replace(self, commitments=others | ({DRAWN: drawn} if drawn else {}), stamps=stamps)

    def plan(self, model: GaussianModel, settled: Settled, draw: int = 0) -> Plan:
        """The plan of one copy's draw."""
        layers = Layers(settled.plan.layout, settled.grain, settled.copies, draw)
        promised = self.message, self.cameras, self.landmarks, self.commitments
        return plan_of(layers, *promised, antialiased=model.antialiased)


@dataclass(frozen=True, eq=False)
class OwnerMark:
    """The layer that all copies share, settled."""

    settled: Settled
    committed: Committed  # with what was drawn for it
    drawn: Drawn
    signed: Float64  # (C,) displacement of each chip of the tint
    tint: Float32  # (N, D) displacement of the colours
    rough: Float64 | None  # (6 N,) displacement of centres and sizes, in their units; None without a grain
    model: GaussianModel  # with this layer alone
    lattices: Lattices  # of the unmarked model's values, on which those of a marked one stay
    fidelity: Fidelity  # worst view, against the unmarked model as delivered
    capacity: int  # bits that a model carries
    pictured: int  # and one picture of it


@dataclass(frozen=True, eq=False)
class Mark:
    """A marked model and the plan from which its chips follow."""

    model: GaussianModel
    plan: Plan
    copied: Float32 | float  # (N, D) displacement of the colours by the copy layer; 0 where there is none
    fidelity: Fidelity


def make_owner_mark(
    views: ViewSet,
    settled: Settled,
    key: OwnerKey,
    committed: Committed,
    wanted: Fidelity,
    pixels: Float64,
    at_view: AtView | None,
    lattices: Lattices = FREE,
) -> OwnerMark:
    """Mark the model of these views with what all of its copies share.

    CapacityError if the scene cannot carry the message. After `draws` plans the last one stands, with its fidelity.

    Parameters
    ----------
    views : ViewSet
        Of the unmarked model as delivered.
    wanted : Fidelity
        Of the worst view, with a copy layer of public values where there is one.
    pixels : (V, 1) float64
        By how much more a picture of `reference_pixels` shows than each view does.
    """
    bits, model = len(committed.message), views.model
    for left in reversed(range(CONFIG.strength.draws)):
        plan, grain, copies = settled.plan, settled.grain, settled.copies
        pictured = capacity_bits(plan.energies * pixels, plan.layout.chips)
        capacity = max(pictured, grain_capacity(len(model)) if grain.there else 0)
        check_capacity(bits, capacity)
        committed = committed.drawn_for(key, model, settled)
        drawn = draw_owner(key, committed.asset, plan.layout, committed.plan(model, settled))
        signed = plan.layout.amplitudes * drawn.tint.values(committed.message)
        rough = None
        if grain.there:
            chips = spread_grain(drawn.grain_key, len(model), bits, sized=True)
            rough = grain.displacements(chips.values(committed.message))
        tint = plan.layout.displace(signed)
        dither = drawn.lattice_key
        marked = lattices.onto(model, displaced(model, tint, rough), dither)
        seen = marked
        if copies is not None:
            seen = lattices.onto(model, as_a_copy(model, copies, tint, rough), dither)
        fidelity = measure(views, seen, at_view)
        if fidelity.meets(wanted) or not np.isfinite(fidelity.psnr_db) or not left:
            break
        settled = settled.lowered(fidelity, wanted)
    return OwnerMark(settled, committed, drawn, signed, tint, rough, marked, lattices, fidelity, capacity, pictured)


def as_a_copy(model: GaussianModel, copies: CopyLayer | None, tint: Float32, rough: Float64 | None) -> GaussianModel:
    """The model displaced by the owner's layer as a copy of it will be, but for values that are not its own."""
    if copies is None:
        return displaced(model, tint, rough)
    chips = copies.layout.chips, copies.grain.chips(len(model))
    usual, own = copies.displacements(np.concatenate([public_values(count) for count in chips]))
    return displaced(model, tint + usual, _sum(rough, own))


def make_mark(
    views: ViewSet, owner: OwnerMark, key: OwnerKey, copy: str, wanted: Fidelity, at_view: AtView | None
) -> Mark:
    """One recipient's copy; where there is no copy layer, the owner's mark by itself."""
    settled, committed, model = owner.settled, owner.committed, views.model
    copies = settled.copies
    if copies is None:
        return Mark(owner.model, committed.plan(model, settled), 0.0, owner.fidelity)
    best: Mark | None = None
    for draw in range(CONFIG.strength.copy_draws):
        plan = committed.plan(model, settled, draw)
        secret = draw_copy(key, committed.asset, copy, plan)
        copied, rough = copies.displacements(copies.spreading(secret, None, len(model)).values(ONE_BIT))
        marked = displaced(model, owner.tint + copied, _sum(owner.rough, rough))
        marked = owner.lattices.onto(model, marked, secret)
        made = Mark(marked, plan, copied, measure(views, marked, at_view))
        if best is None or made.fidelity.room_to(wanted) > best.fidelity.room_to(wanted):
            best = made
        if made.fidelity.meets(wanted) or not np.isfinite(made.fidelity.psnr_db):
            break
    assert best is not None
    return best


def mark_again(opened: OpenedRecord) -> GaussianModel:
    """A record's marked model, drawn again: what was delivered but for rounding, to the original's lattice and by its
    file's format."""
    return displaced(opened.reference, *whole_displacements(opened))


def whole_displacements(opened: OpenedRecord) -> tuple[Float32, Float64 | None]:
    """As `owner_displacements`, with the copy layer's on top."""
    tint, rough = owner_displacements(opened)
    if opened.copies is None:
        return tint, rough
    copied, own = opened.copies.displacements(opened.copy_spreading().values(ONE_BIT))
    return tint + copied, _sum(rough, own)


def displaced(model: GaussianModel, tint: Float32, rough: Float64 | None) -> GaussianModel:
    """The model with its colours displaced by (N, D) and, where it has a grain, its centres and sizes by (6 N,)."""
    model = model.with_(sh=add_dc(model.sh, tint))
    return model if rough is None else roughen(model, ONE_GRAIN, rough.astype(np.float32).reshape(-1, ATTRIBUTES))


def _sum(one: Float64 | None, other: Float64 | None) -> Float64 | None:
    return other if one is None else one if other is None else one + other


ONE_GRAIN = Grain(1.0, 1.0)
"""In whose amplitudes displacements are given in their own units."""
