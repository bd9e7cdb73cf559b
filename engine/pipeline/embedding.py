"""The embedding flow: model -> prune -> quantise -> displace code vectors -> refine -> marked model and record.

1. Look at the model from the key views.            5. Plan carriers and amplitudes; commit to them.
2. Prune to the budget, if one was given.           6. Draw bits and chips from the owner's key.
3. Fix the canonical reference.                     7. Solve the strength; refine; solve it again.
4. Quantise hierarchically.                         8. Write the record: all that verification needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.compress.hvq import quantize
from engine.compress.impact import measure_impact, uncertainty
from engine.errors import InputError
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.pipeline.delivery import color_weights, slim_down, unmarked_delivery
from engine.pipeline.profiles import EmbedConfig, config_dict
from engine.pipeline.progress import Clock, Progress
from engine.pipeline.rigs import Extent, make_rig, measure_extent
from engine.pipeline.scenes import look, worst_psnr_against
from engine.pipeline.sealing import draw_spreading, make_record, plan_of
from engine.pipeline.strength import Strength, add_dc, solve_strength
from engine.pipeline.variant import PLAIN, Variant
from engine.watermark.keys import POSE, OwnerKey, uniform
from engine.watermark.landmarks import Landmarks, make_landmarks
from engine.watermark.masses import spare_masses
from engine.watermark.messages import Signs, check_bits, derive_message, message_hex
from engine.watermark.planning import capacity_bits, check_capacity, make_plan, predict_z
from engine.watermark.record import Record
from engine.watermark.reference_codec import encode_reference, reference_digest
from engine.watermark.spreading import signed_amplitudes

LANDMARK_SIZE = (640, 480)
"""Pixels of a view of the landmark bank."""
LEAST_WIDTH = 1e-4
"""Of the centres across a line through them, in its length: a rotation about the line itself shows nowhere."""


@dataclass(frozen=True, eq=False)
class Embedding:
    """What an embedding gives back.

    Parameters
    ----------
    model : GaussianModel
        The marked model to deliver.
    record : Record
        What the owner keeps.
    report : dict
        Measurements for people and machines (`embed --json`).
    """

    model: GaussianModel
    record: Record
    report: dict[str, Any]


def embed(
    model: GaussianModel,
    key: OwnerKey,
    *,
    original_sha256: str,
    message: Signs | None = None,
    bits: int = 32,
    config: EmbedConfig | None = None,
    cameras: Sequence[Camera] | None = None,
    copy: str = "",
    registered_at: str = "",
    progress: Progress | None = None,
    variant: Variant = PLAIN,
) -> Embedding:
    """Mark a model.

    Parameters
    ----------
    model : GaussianModel
    key : OwnerKey
    original_sha256 : str
        Hex digest of the owner's file; the record commits to it.
    message : (B,) signs, optional
        Derived from the key where not given.
    bits : int
        Length of a derived message.
    config : EmbedConfig, optional
    cameras : sequence of Camera, optional
        The owner's own cameras; key views are chosen among them. Generated from the model otherwise.
    copy : str
        Name of the recipient; every copy has a message and chips of its own.
    registered_at : str
        Time of registration as the caller knows it; no clock is read here.
    progress : callable, optional
    variant : Variant, optional
        What is special about a model that moves, or brings its own codebook.

    Returns
    -------
    Embedding

    Raises
    ------
    CapacityError
        If the scene cannot carry the message at the asked fidelity.
    InputError
        If the model or the options are unusable.
    """
    config = config or EmbedConfig()
    clock = Clock(progress)
    bits = len(message) if message is not None else bits
    check_bits(bits)
    if len(model) < 64:
        raise InputError(f"a mark needs at least 64 Gaussians, this model has {len(model)}")
    asset = bytes.fromhex(original_sha256)
    keeps_rows = config.prune.budget_db is None and config.output == "fidelity"
    variant.check(model, keeps_rows=keeps_rows, refines=config.refine.steps > 0)

    with clock.stage("look"):  # 1
        extent = measure_extent(model)
        _check_placeable(model, extent)
        key_cameras = _key_cameras(model, key, asset, config, cameras, extent)
        original = look(model, key_cameras, clock.advance, variant.at_view)
        impact = measure_impact(model, original.views, original.images)
    with clock.stage("prune"):  # 2
        slim, pruned = slim_down(model, original, impact, extent, config)
    with clock.stage("quantize"):  # 3, 4
        if len(slim) != len(model):
            fewer = look(slim, key_cameras, clock.advance)
            impact = measure_impact(slim, fewer.views, fewer.images)
        weights = color_weights(slim, impact)
        stages = variant.own_stages(slim, weights) or quantize(slim, weights, extent.radius, config.quantize)
        delivered, stages = unmarked_delivery(slim, stages, original, impact, config)
        emphasis: Float32 | Float64 | None = variant.emphasis_on(impact)
        # A file's own codebook and the compact output keep few values on purpose: no sign of clipping.
        if variant.labels is None and config.output == "fidelity":
            stages, emphasis = spare_masses(delivered.sh[:, 0], stages, config.plan.mass_share, emphasis)
        reference_arrays = encode_reference(delivered)
        digest = reference_digest(reference_arrays)
    with clock.stage("landmarks"):
        landmarks = _landmarks(delivered, extent, config, clock)
    with clock.stage("plan"):  # 5, 6
        views = look(delivered, key_cameras, clock.advance, variant.at_view)
        plan = make_plan(stages, impact, config.plan, emphasis)
        layout = plan.layout
        sign = message if message is not None else derive_message(key, bits, digest + copy.encode())
        committed = plan_of(layout, sign, key_cameras, landmarks, variant.commitments)
        spreading = draw_spreading(key, digest, copy, layout, committed)
        signed = signed_amplitudes(layout.amplitudes, spreading, sign)
        displacement = layout.displace(signed)
        pixels = 3.0 * key_cameras[0].width * key_cameras[0].height
        guess = 10 ** (-config.psnr_db / 20.0) * float(
            np.sqrt(pixels / max(plan.energies.sum(axis=1).max(), 1e-30))
        )
        strength = solve_strength(views, displacement, config.psnr_db, config.ssim, guess)
        capacity = capacity_bits(plan.energies, strength.factor, layout.chips)
        check_capacity(bits, capacity)
    displacement = np.float32(strength.factor) * displacement
    if config.refine.steps > 0:
        with clock.stage("refine"):  # 7
            from engine.pipeline.refinement import refine  # torch is only needed here

            doubt = uncertainty(impact.squared)
            displacement = refine(
                delivered, displacement, list(key_cameras), layout, signed, spreading.bit_of, bits, doubt,
                config.refine, clock.advance,
            )  # fmt: skip
            again = solve_strength(views, displacement, config.psnr_db, config.ssim, 1.0)
            displacement = np.float32(again.factor) * displacement
            strength = Strength(strength.factor, again.psnr_db, again.ssim)
    marked = delivered.with_(sh=add_dc(delivered.sh, displacement))
    with clock.stage("record"):  # 8
        record = make_record(
            key, reference_arrays, committed, strength.factor, original_sha256=original_sha256, copy=copy,
            registered_at=registered_at, settings=config_dict(config),
        )  # fmt: skip
        total = worst_psnr_against(original.images, key_cameras, variant.at_view)(marked)
    predicted = predict_z(plan.energies, strength.factor, spreading.bit_of, bits)
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
        **pruned,
        "seconds": clock.total,
        "seconds_by_stage": clock.seconds,
    }
    return Embedding(marked, record, report)


def _check_placeable(model: GaussianModel, extent: Extent) -> None:
    """Refuse what no registration could place again: centres in one point, on a line, or rounded away."""
    means = model.means.astype(np.float64)
    furthest = float(np.abs(means).max())
    if extent.radius <= float(np.spacing(np.float32(np.abs(extent.center).max()))):
        raise InputError(
            f"this model lies {furthest:.3g} from the origin and is {extent.radius:.3g} across: float32 cannot tell "
            "its centres apart; move it nearer"
        )
    spread = np.linalg.svd(np.cov(means.T, bias=True), compute_uv=False)  # variances along the principal axes
    if spread[1] <= LEAST_WIDTH**2 * spread[0]:
        raise InputError(
            "the centres of this model lie in one point or on a line: a copy of it could not be registered"
        )


def _key_cameras(
    model: GaussianModel,
    key: OwnerKey,
    asset: bytes,
    config: EmbedConfig,
    cameras: Sequence[Camera] | None,
    extent: Extent,
) -> list[Camera]:
    """The pose key: views chosen by the owner's key, among the owner's cameras or around the model."""
    draw = uniform(key.derive(POSE, asset), 4 * config.views).reshape(config.views, 4)
    if not cameras:
        return make_rig(model, config.views, config.view_size, config.view_size, jitter=draw, extent=extent)
    count = min(config.views, len(cameras))
    slots = np.linspace(0, len(cameras), count + 1)
    slot = [
        int(low + u * (high - low)) for low, high, u in zip(slots[:-1], slots[1:], draw[:, 0], strict=False)
    ]
    chosen = [cameras[min(i, len(cameras) - 1)] for i in slot]
    shrink = [min(1.0, config.view_size / max(c.width, c.height)) for c in chosen]
    return [
        c.resized(max(1, round(c.width * f)), max(1, round(c.height * f)))
        for c, f in zip(chosen, shrink, strict=True)
    ]


def _landmarks(model: GaussianModel, extent: Extent, config: EmbedConfig, clock: Clock) -> Landmarks | None:
    """The bank by which the camera of a screenshot is found; regular views of the unmarked model."""
    if config.landmark_views == 0:
        return None
    rig = make_rig(model, config.landmark_views, *LANDMARK_SIZE, extent=extent)
    return make_landmarks(model, rig, clock.advance)
