"""The embedding flow: model -> prune -> quantise -> displace code vectors -> refine -> marked model and record.

0. Choose the settings, where that is left open.
1. Look at the model from the key views.            5. Plan carriers and amplitudes; commit to them.
2. Prune to the budget, if one was given.           6. Draw bits and chips from the owner's key.
3. Fix the canonical reference.                     7. Solve the strength; refine; solve it again.
4. Quantise hierarchically.                         8. Write the record: all that verification needs.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from engine.compress.impact import uncertainty
from engine.errors import InputError
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.pictures.landmarks import Landmarks, make_landmarks
from engine.pipeline.choosing import Choice, choose
from engine.pipeline.delivery import slim_down, unmarked_delivery
from engine.pipeline.groundwork import lay_groundwork
from engine.pipeline.profiles import Auto, EmbedConfig, Settings
from engine.pipeline.progress import Clock, Progress
from engine.pipeline.rigs import Extent, make_rig
from engine.pipeline.scenes import worst_psnr_against
from engine.pipeline.sealing import DRAWN, draw_spreading, plan_of
from engine.pipeline.strength import Strength, add_dc, first_guess, solve_strength
from engine.pipeline.variant import PLAIN, Variant
from engine.records.record import Record
from engine.records.reference import encode_reference, reference_digest
from engine.watermark.keys import OwnerKey
from engine.watermark.masses import spare_masses
from engine.watermark.messages import Signs, check_bits, derive_message, message_hex
from engine.watermark.planning import capacity_bits, check_capacity, make_plan, predict_z
from engine.watermark.spreading import signed_amplitudes

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
        emphasis: Float32 | Float64 | None = variant.emphasis_on(impact)
        # A file's own codebook and the compact output keep few values on purpose: no sign of clipping.
        if variant.labels is None and settings.output == "fidelity":
            stages, emphasis = spare_masses(delivered.sh[:, 0], stages, settings.plan.mass_share, emphasis)
        reference_arrays = encode_reference(delivered)
        digest = reference_digest(reference_arrays)
    with clock.stage("landmarks"):
        landmarks = _landmarks(delivered, extent, settings, clock)
    with clock.stage("plan"):  # 5, 6
        views = ground.views_of(delivered, clock)
        plan = make_plan(stages, impact, settings.plan, emphasis)
        layout = plan.layout
        sign = message if message is not None else derive_message(key, bits, digest + copy.encode())
        committed = plan_of(layout, sign, key_cameras, landmarks, {**variant.commitments, **_drawn(drawn)})
        spreading = draw_spreading(key, digest, copy, layout, committed)
        signed = signed_amplitudes(layout.amplitudes, spreading, sign)
        displacement = layout.displace(signed)
        guess = first_guess(plan.energies, key_cameras, settings.psnr_db)
        strength = solve_strength(views, displacement, settings.psnr_db, settings.ssim, guess)
        pictured = plan.energies * ground.picture_scale
        capacity = capacity_bits(pictured, strength.factor, layout.chips)
        check_capacity(bits, capacity)
    displacement = np.float32(strength.factor) * displacement
    if settings.refine.steps > 0:
        with clock.stage("refine"):  # 7
            from engine.pipeline.refinement import refine  # torch is only needed here

            doubt = uncertainty(impact.squared)
            displacement = refine(
                delivered,
                displacement,
                list(key_cameras),
                layout,
                signed,
                spreading.bit_of,
                bits,
                doubt,
                settings.refine,
                clock.advance,
            )
            again = solve_strength(views, displacement, settings.psnr_db, settings.ssim, 1.0)
            displacement = np.float32(again.factor) * displacement
            strength = Strength(strength.factor, again.psnr_db, again.ssim)
    marked = delivered.with_(sh=add_dc(delivered.sh, displacement))
    with clock.stage("record"):  # 8
        record = Record.make(
            key,
            reference_arrays,
            original_digest=original_sha256,
            plan=committed[0],
            plan_arrays=committed[1],
            extra={"strength": strength.factor, "settings": asdict(settings)},
            copy=copy,
            registered_at=registered_at,
        )
        total = strength.psnr_db
        if delivered is not model:
            total = worst_psnr_against(original.images, key_cameras, variant.at_view)(marked)
    predicted = predict_z(pictured, strength.factor, spreading.bit_of, bits)
    report = {
        "gaussians_in": len(model),
        "gaussians_out": len(marked),
        "bits": bits,
        "message": message_hex(sign),
        "copy": copy,
        "record_id": record.header.record_id,
        "psnr_worst_view": strength.psnr_db,
        "ssim_worst_view": strength.ssim,
        "psnr_total_worst_view": total,
        "predicted_z_per_bit": float(predicted.min(axis=1).mean()),
        "capacity_bits": capacity,
        "chips": layout.chips,
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
