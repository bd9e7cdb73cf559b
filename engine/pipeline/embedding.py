"""The embedding flow: model -> prune -> quantise -> displace code vectors -> refine -> marked model and record.

0. Choose the settings, where that is left open.
1. Look at the model from the key views.            5. Plan both layers; commit to the plan.
2. Prune to the budget, if one was given.           6. Settle the strength; draw bits and chips from the key.
3. Fix the canonical reference.                     7. Refine, where that was asked for.
4. Quantise hierarchically.                         8. Write the record: all that verification needs.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from engine.compress.hvq import group_means
from engine.compress.impact import uncertainty
from engine.errors import InputError
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.pictures.landmarks import Landmarks, make_landmarks
from engine.pipeline.choosing import Choice, choose
from engine.pipeline.delivery import slim_down, unmarked_delivery
from engine.pipeline.groundwork import lay_groundwork
from engine.pipeline.marking import Committed, Copy, make_mark
from engine.pipeline.profiles import Auto, EmbedConfig, Settings
from engine.pipeline.progress import Clock, Progress
from engine.pipeline.rigs import Extent, make_rig
from engine.pipeline.scenes import worst_psnr_against
from engine.pipeline.sealing import DRAWN
from engine.pipeline.settling import measure, settle
from engine.pipeline.strength import Fidelity, add_dc, solve_strength
from engine.pipeline.variant import PLAIN, Variant
from engine.records.record import Record
from engine.records.reference import encode_reference, reference_digest
from engine.watermark.keys import OwnerKey
from engine.watermark.masses import spare_masses
from engine.watermark.messages import Signs, check_bits, derive_message, message_hex
from engine.watermark.planning import make_plan, predict_z
from engine.watermark.secret_cells import cells_key, jitter, join_cells
from engine.watermark.unpredictability import unexplained

LANDMARK_SIZE = (640, 480)
"""Pixels of a view of the landmark bank."""


@dataclass(frozen=True, eq=False)
class Embedding:
    """What an embedding gives back."""

    model: GaussianModel  # the marked model to deliver
    record: Record  # what the owner keeps
    config: EmbedConfig  # the settings used: the chosen ones, where that was left open
    report: dict[str, Any]  # measurements for people and machines (`embed --json`)


@one_blas_thread
def embed(
    model: GaussianModel,
    key: OwnerKey,
    *,
    original_sha256: str,
    message: Signs | None = None,
    bits: int = 32,
    config: Settings | None = None,
    cameras: Sequence[Camera] | None = None,
    copy: str = "",
    registered_at: str = "",
    progress: Progress | None = None,
    variant: Variant = PLAIN,
    drawn: str = "",
) -> Embedding:
    """Mark a model.

    CapacityError if the scene cannot carry the message at the asked fidelity; InputError if the model or the options
    are unusable.

    Parameters
    ----------
    original_sha256 : str
        Hex digest of the owner's file; the record commits to it.
    message : (B,) signs, optional
        Derived from the key where not given.
    bits : int
        Length of a derived message.
    config : EmbedConfig or Auto, optional
        See `profiles.compose`.
    cameras : sequence of Camera, optional
        The owner's own cameras; key views are chosen among them. Generated from the model otherwise.
    copy : str
        Name of the recipient; every copy has a message and chips of its own.
    registered_at : str
        Time of registration as the caller knows it; no clock is read here.
    variant : Variant, optional
        What is special about a model that moves, or brings its own codebook.
    drawn : str
        What whoever attests the registration drew for it, when key and original were settled: it enters the plan, and
        so decides the chips, which nobody can then try out beforehand.
    """
    clock = Clock(progress)
    bits = len(message) if message is not None else bits
    check_bits(bits)
    choice: Choice | None = None
    if isinstance(config, Auto):
        if variant is not PLAIN:
            raise InputError("a variant is not rehearsed: name its settings instead of 'auto'")
        with clock.stage("choose"):  # 0
            choice = choose(model, key, bits, config, original_sha256, cameras)
        settings = choice.config
    else:
        settings = config or EmbedConfig()
    keeps_rows = settings.prune.budget_db is None and settings.output == "fidelity"
    variant.check(model, keeps_rows=keeps_rows, refines=settings.refine.steps > 0)

    with clock.stage("look"):  # 1
        # What was rehearsed on is gone on from: nothing is looked at twice.
        ground = (
            choice.ground if choice else lay_groundwork(model, key, original_sha256, settings, cameras, variant, clock)
        )
        original, extent, key_cameras = ground.views, ground.extent, ground.cameras
    with clock.stage("prune"):  # 2
        slim, pruned = slim_down(model, original, ground.impact, extent, settings)
    with clock.stage("quantize"):  # 3, 4
        ground = ground.of(slim, clock)
        impact = ground.impact
        delivered, stages = unmarked_delivery(slim, ground.stages, original, impact, settings)
        reference_arrays = encode_reference(delivered)
        digest = reference_digest(reference_arrays)
        secret = cells_key(key, digest, copy)
        missed = None
        if variant.labels is None:
            joined = join_cells(stages[0], ground.cell_features, delivered, ground.colors, settings.plan.codes, secret)
            stages = (joined, *stages[1:])
            centers = group_means(delivered.means, joined.labels, ground.colors).astype(np.float64)
            missed = unexplained(centers, joined.codebook[:, :3].astype(np.float64))
        emphasis: Float32 | Float64 | None = variant.emphasis_on(impact)
        # A file's own codebook and the compact output keep few values on purpose: no sign of clipping.
        if variant.labels is None and settings.output == "fidelity":
            stages, emphasis = spare_masses(delivered.sh[:, 0], stages, settings.plan.mass_share, emphasis)
            if missed is not None and len(stages[0].codebook) > len(missed):
                missed = np.concatenate([missed, missed.mean(axis=0, keepdims=True)])
    with clock.stage("landmarks"):
        landmarks = _landmarks(delivered, extent, settings, clock)
    with clock.stage("plan"):  # 5, 6
        views = ground.views_of(delivered, clock)
        grainy = variant is PLAIN and settings.plan.grain_center + settings.plan.grain_scale > 0.0
        settled = settle(
            views,
            make_plan(stages, impact, settings.plan, emphasis, missed, lambda chips: jitter(secret, chips)),
            settings,
            grainy=grainy,
        )
    with clock.stage("mark"):
        sign = message if message is not None else derive_message(key, bits, digest + copy.encode())
        mark = make_mark(
            views,
            settled,
            Copy(key, digest, copy, sign),
            Committed(key_cameras, landmarks, {**variant.commitments, **_drawn(drawn)}),
            Fidelity(settings.psnr_db, settings.ssim),
            ground.picture_scale,
            variant.at_view,
        )
        plan = mark.settled.plan
    marked, fidelity = mark.model, mark.fidelity
    if settings.refine.steps > 0:
        with clock.stage("refine"):  # 7
            from engine.pipeline.refinement import refine  # torch is only needed here

            doubt = uncertainty(impact.squared)
            displacement = refine(
                delivered,
                plan.layout.displace(mark.signed),
                list(key_cameras),
                plan.layout,
                mark.signed,
                mark.spreading.bit_of,
                bits,
                doubt,
                settings.refine,
                clock.advance,
            )
            again = solve_strength(views, displacement, mark.settled.tint.psnr_db, mark.settled.tint.ssim, 1.0)
            marked = marked.with_(sh=add_dc(delivered.sh, np.float32(again.factor) * displacement))
            fidelity = measure(views, marked)
    with clock.stage("record"):  # 8
        record = Record.make(
            key,
            reference_arrays,
            original_digest=original_sha256,
            plan=mark.plan[0],
            plan_arrays=mark.plan[1],
            extra={"settings": asdict(settings)},
            copy=copy,
            registered_at=registered_at,
        )
        total = fidelity.psnr_db
        if delivered is not model:
            total = worst_psnr_against(original.images, key_cameras, variant.at_view)(marked)
    predicted = predict_z(plan.energies * ground.picture_scale, mark.spreading.bit_of, bits)
    report = {
        "gaussians_in": len(model),
        "gaussians_out": len(marked),
        "bits": bits,
        "message": message_hex(sign),
        "copy": copy,
        "record_id": record.header.record_id,
        "psnr_worst_view": fidelity.psnr_db,
        "ssim_worst_view": fidelity.ssim,
        "psnr_total_worst_view": total,
        "predicted_z_per_bit": float(predicted.min(axis=1).mean()),
        "capacity_bits": mark.capacity,
        "picture_bits": mark.pictured,
        "chips": plan.layout.chips,
        "grain": asdict(mark.settled.grain),
        "choice": None if choice is None else choice.report(),
        **pruned,
        "seconds": clock.total,
        "seconds_by_stage": clock.seconds,
    }
    return Embedding(marked, record, settings, report)


def _drawn(drawn: str) -> dict[str, str]:
    return {DRAWN: drawn} if drawn else {}


def _landmarks(model: GaussianModel, extent: Extent, config: EmbedConfig, clock: Clock) -> Landmarks | None:
    """The bank by which the camera of a screenshot is found; regular views of the unmarked model."""
    if config.landmark_views == 0:
        return None
    rig = make_rig(model, config.landmark_views, *LANDMARK_SIZE, extent=extent)
    return make_landmarks(model, rig, clock.advance)
