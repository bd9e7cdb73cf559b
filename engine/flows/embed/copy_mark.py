"""One copy's mark: bits and chips drawn from the key for a settled plan, put into the model, and looked at."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from engine.flows.embed.layer_strengths import Fidelity, Settled, add_dc, measure
from engine.flows.embed.variant import AtView
from engine.flows.records.opened_record import OpenedRecord, draw_spreading, plan_of
from engine.flows.views.view_set import ViewSet
from engine.model import Camera, Float64, GaussianModel
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.records.record import Plan
from engine.watermark.grain import ATTRIBUTES, Grain, roughen
from engine.watermark.keys import OwnerKey
from engine.watermark.layout import Layout
from engine.watermark.messages import Signs
from engine.watermark.planning import capacity_bits, check_capacity, grain_capacity
from engine.watermark.spreading import Spreading, signed_amplitudes, spread_grain

DRAWS = 4
"""Plans tried: weaker ones where a copy's own chips show more than the public ones did."""


@dataclass(frozen=True, eq=False)
class Copy:
    """What tells one copy of an asset from another, before its chips."""

    key: OwnerKey
    asset: bytes  # digest of the canonical reference
    name: str  # of the recipient
    message: Signs


@dataclass(frozen=True, eq=False)
class Committed:
    """What the records of all copies commit to beside the plan."""

    cameras: Sequence[Camera]
    landmarks: Landmarks | None
    commitments: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Mark:
    """A marked model and the plan from which its chips follow."""

    model: GaussianModel
    plan: Plan
    spreading: Spreading  # of the tint
    signed: Float64  # (C,) displacement of each chip of the tint
    settled: Settled
    fidelity: Fidelity  # worst view, against the unmarked model as delivered
    capacity: int  # bits that a model carries
    pictured: int  # and one picture of it


def make_mark(
    views: ViewSet,
    settled: Settled,
    copy: Copy,
    committed: Committed,
    wanted: Fidelity,
    pixels: Float64,
    at_view: AtView | None,
) -> Mark:
    """Mark the model of these views.

    CapacityError if the scene cannot carry the message. After DRAWS plans the last one stands, and its fidelity tells.

    Parameters
    ----------
    views : ViewSet
        Of the unmarked model as delivered.
    wanted : Fidelity
        Of the worst view. Where the key's chips miss it, the plan is made weaker, which draws others.
    pixels : (V, 1) float64
        By how much more a picture of REFERENCE_PIXELS shows than each view does.
    """
    bits = len(copy.message)
    for left in reversed(range(DRAWS)):
        plan, grain = settled.plan, settled.grain
        pictured = capacity_bits(plan.energies * pixels, plan.layout.chips)
        capacity = max(pictured, grain_capacity(len(views.model)) if grain.there else 0)
        check_capacity(bits, capacity)
        promised = plan_of(
            plan.layout,
            grain,
            copy.message,
            committed.cameras,
            committed.landmarks,
            committed.commitments,
            antialiased=views.model.antialiased,
        )
        tint, grain_key = draw_spreading(copy.key, copy.asset, copy.name, plan.layout, promised)
        signed = signed_amplitudes(plan.layout.amplitudes, tint, copy.message)
        rough = spread_grain(grain_key, len(views.model), bits).signs(copy.message) if grain.there else None
        model = displaced(views.model, plan.layout, signed, grain, rough)
        fidelity = measure(views, model, at_view)
        if fidelity.meets(wanted) or not np.isfinite(fidelity.psnr_db) or not left:
            break
        settled = settled.lowered(fidelity, wanted)
    return Mark(model, promised, tint, signed, settled, fidelity, capacity, pictured)


def mark_again(opened: OpenedRecord) -> GaussianModel:
    """A record's marked model, drawn again: what was delivered but for the rounding of its file's format."""
    layout, grain, chips = opened.layout, opened.grain, opened.layout.chips
    signs = opened.spreading_of(chips + grain.chips(len(opened.reference))).signs(opened.message)
    signed = opened.strength * layout.amplitudes * signs[:chips]
    return displaced(opened.reference, layout, signed, grain, signs[chips:] if grain.there else None)


def displaced(
    model: GaussianModel, layout: Layout, signed: Float64, grain: Grain, rough: npt.NDArray[np.int8] | Float64 | None
) -> GaussianModel:
    """The model with its tint displaced by `signed` (C,) and, where it has a grain, roughened by signs (6 N,)."""
    model = model.with_(sh=add_dc(model.sh, layout.displace(signed)))
    return model if rough is None else roughen(model, grain, rough.astype(np.float32).reshape(-1, ATTRIBUTES))
