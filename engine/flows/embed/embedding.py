"""The embedding flow: model -> prune -> quantise -> displace code vectors -> refine -> marked model and record.

0. Choose the settings, where that is left open.
1. Look at the model from the key views.            5. Plan both layers; commit to the plan.
2. Prune to the budget, if one was given.           6. Settle the strength; draw bits and chips from the key.
3. Fix the canonical reference.                     7. Refine, where configured.
4. Quantise hierarchically.                         8. Write the record: all that verification needs.

Up to the landmarks all copies of a model have everything in common: see `asset`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Unpack

import numpy as np

from engine.errors import InputError
from engine.extras import load_extra
from engine.flows.embed.asset import Asset, bank_of, known_landmarks
from engine.flows.embed.auto_profile import Choice, ChoiceReport, choose
from engine.flows.embed.copy_mark import make_mark
from engine.flows.embed.delivery import Pruned, deliver
from engine.flows.embed.draft import Draft
from engine.flows.embed.draws import SECOND_WATERMARK, is_copy_of, second_watermark, shares_layer
from engine.flows.embed.landmark_bank import Bank
from engine.flows.embed.layer_strengths import Fidelity
from engine.flows.embed.planning_basis import lay_groundwork
from engine.flows.embed.profiles import Auto, EmbedConfig
from engine.flows.embed.terms import MarkOptions, MarkTerms
from engine.flows.progress import Clock, Progress
from engine.flows.records.draw import shared_values, stamps_extra
from engine.flows.records.opened_record import ORIGIN
from engine.flows.views.view_set import SeenView, psnr_by_view
from engine.model import GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.numerics.plain import Json, Report
from engine.raster.cuda import draws_alike, find_device
from engine.records.record import Plan, Record
from engine.watermark.grain import Grain
from engine.watermark.keys import OwnerKey
from engine.watermark.messages import message_hex
from engine.watermark.planning import predict_claim


@dataclass(frozen=True, eq=False)
class EmbedReport(Report):
    """Measurements of one embedding, for people and machines (`embed --json`)."""

    gaussians_in: int
    gaussians_out: int
    bits: int
    message: str  # hexadecimal
    copy: str  # name of the recipient
    record_id: str
    psnr_worst_view: float  # dB, of the mark alone
    ssim_worst_view: float  # of the mark alone
    psnr_total_worst_view: float  # dB, with pruning and quantization
    predicted_z_render: float  # of a claim from one own render of 800 x 800 pixels, at JPEG 10
    capacity_bits: int  # that a model carries
    picture_bits: int  # that one picture carries
    chips: int  # of the tint
    grain: Grain
    device: str  # "cuda" where a GPU fitted what pruning left, or refined
    choice: ChoiceReport | None  # where the settings were left open
    pruned: Pruned
    seconds: float
    seconds_by_stage: dict[str, float]

    def to_json(self) -> Json:
        """Plain values; what was pruned is among the rest."""
        found = super().to_json()
        del found["pruned"]
        return found | self.pruned.to_json()


@dataclass(frozen=True, eq=False)
class Embedding:
    """What an embedding gives back."""

    model: GaussianModel  # the marked model to deliver
    record: Record  # what the owner keeps
    config: EmbedConfig  # the settings used: the chosen ones, where that was left open
    report: EmbedReport
    worst_view: SeenView  # the original in the key view of `psnr_total_worst_view`
    bank: Bank | None  # None if no landmarks were wanted


def embed(
    model: GaussianModel,
    key: OwnerKey,
    *,
    original_sha256: str,
    copy: str = "",
    progress: Progress | None = None,
    **options: Unpack[MarkOptions],
) -> Embedding:
    """Mark a model.

    CapacityError if the scene cannot carry the message at the wanted fidelity; InputError if the model or the options
    are unusable.

    Parameters
    ----------
    original_sha256 : str
        Hex digest of the owner's file; the record commits to it.
    copy : str
        Name of the recipient; every copy has a message and chips of its own.
    **options
        `message`, `bits`, `config`, `cameras`, `registered_at`, `stamp`, `earlier`, `variant`: see `terms.MarkTerms`.
    """
    return next(embed_copies(model, key, [copy], original_sha256=original_sha256, progress=progress, **options))


def embed_copies(
    model: GaussianModel,
    key: OwnerKey,
    copies: Sequence[str],
    *,
    original_sha256: str,
    progress: Progress | None = None,
    **options: Unpack[MarkOptions],
) -> Iterator[Embedding]:
    """Mark a model for each of these recipients, one after another; parameters as for `embed`.

    The same bytes as single embeddings, in a part of the time: what takes long is done once. The first report's
    seconds include it.
    """
    return embed_on_terms(model, key, copies, MarkTerms(**options), original_sha256=original_sha256, progress=progress)


def embed_on_terms(
    model: GaussianModel,
    key: OwnerKey,
    copies: Sequence[str],
    terms: MarkTerms,
    *,
    original_sha256: str,
    progress: Progress | None = None,
) -> Iterator[Embedding]:
    """`embed_copies` with its options as one value."""
    clock = Clock(progress)
    if terms.cameras is not None and any(model.origin):
        terms = replace(terms, cameras=[camera.relative_to(model.origin) for camera in terms.cameras])
    if len({bool(copy) for copy in copies}) > 1:
        raise InputError(f"some copies have a recipient's name and others have none: {SECOND_WATERMARK}")
    asset = _prepare(model, key, original_sha256, terms, bool(copies and copies[0]), clock)
    for copy in copies:
        yield _mark(asset, key, copy, clock)
        clock = Clock(progress)


@one_blas_thread
def _prepare(
    model: GaussianModel, key: OwnerKey, original_sha256: str, terms: MarkTerms, copied: bool, clock: Clock
) -> Asset:
    """Everything up to the recipient's own part."""
    config, variant = terms.config or EmbedConfig(), terms.variant
    choice: Choice | None = None
    if isinstance(config, Auto) and terms.earlier is not None and is_copy_of(terms.earlier, original_sha256, key):
        config = config.as_earlier(EmbedConfig.from_json(terms.earlier.extra["settings"]))
    if isinstance(config, Auto) and variant.at_view is not None:
        raise InputError("a variant that moves is not rehearsed: name its settings instead of 'auto'")
    config = _on_device(config, model, key, original_sha256, terms)
    start = config.start if isinstance(config, Auto) else config
    variant.check(model, keeps_rows=start.keeps_rows, refines=start.refine.steps > 0)
    if isinstance(config, Auto):
        with clock.stage("choose"):  # 0
            choice = choose(model, key, terms.length, config, original_sha256, terms.cameras, variant, copied=copied)
    settings = start if choice is None else choice.config
    if settings.refine.steps > 0:  # said now, not when the work is half done
        load_extra("torch", "train", "refinement (refine.steps > 0)")

    with clock.stage("look"):  # 1
        # What was rehearsed on is gone on from: nothing is looked at twice.
        seen = (model, key, original_sha256, settings, terms.cameras, variant, clock)
        original = choice.ground if choice else lay_groundwork(*seen)
    # 2, 3, 4
    draft = choice.draft if choice else Draft(deliver(original, settings, clock), variant, key, copied)
    with clock.stage("quantize"):
        digest = draft.digest
    with clock.stage("landmarks"):
        known = None if terms.earlier is None else known_landmarks(terms.earlier, digest, settings)
        bank = bank_of(draft.delivery.model, original.extent, settings, clock, known)
    return Asset(original, original_sha256, terms, settings, choice, draft, bank)


def _on_device(
    config: EmbedConfig | Auto, model: GaussianModel, key: OwnerKey, original_sha256: str, terms: MarkTerms
) -> EmbedConfig | Auto:
    """The settings with what will fit: the CPU where nothing is fitted, or where a GPU would draw other pictures.

    InputError where a GPU is wanted and there is none; or where a further copy would need the fit of an earlier one
    again, of which a GPU is not capable.
    """
    start = config.start if isinstance(config, Auto) else config
    fits = (start.recovers or start.refine.steps > 0) and draws_alike(model, terms.cameras or ())
    device = start.device if fits else "cpu"
    if terms.earlier is None or not start.recovers or not is_copy_of(terms.earlier, original_sha256, key):
        device = find_device(device)
    elif terms.earlier.extra["settings"].get("device") == "cuda" or find_device(device) == "cuda":
        raise InputError(
            f"a fit on a GPU never comes out twice the same, so copy {terms.earlier.copy!r} and a further one would "
            "have two watermarks of yours, which anyone finds who compares the files: mark all copies in one command, "
            "or all of them with device 'cpu'"
        )
    else:
        device = "cpu"
    start = replace(start, device=device)
    return replace(config, start=start) if isinstance(config, Auto) else start


@one_blas_thread
def _mark(asset: Asset, key: OwnerKey, copy: str, clock: Clock) -> Embedding:
    """The recipient's own part."""
    terms, settings, variant = asset.terms, asset.settings, asset.terms.variant
    delivery, ground, views = asset.delivery, asset.delivery.ground, asset.delivery.views
    bits, wanted = terms.length, Fidelity(settings.psnr_db, settings.ssim)
    with clock.stage("plan"):  # 5, 6
        owner = asset.owner_mark
    committed, plan = owner.committed, owner.settled.plan
    with clock.stage("mark"):
        if terms.earlier is not None:
            _check_shared(terms.earlier, committed.plan(views.model, owner.settled), asset)
        mark = make_mark(views, owner, key, copy, wanted, variant.at_view)
    marked, fidelity = mark.model, mark.fidelity
    if not np.isfinite(fidelity.psnr_db):
        raise InputError("no key view changes with the mark, at any strength: nothing of what they show can carry one")
    if settings.refine.steps > 0:
        with clock.stage("refine"):  # 7
            from engine.flows.embed.refinement import refine_mark  # torch is only needed here

            marked, fidelity = refine_mark(asset, owner, mark, bits, clock.advance)
    with clock.stage("record"):  # 8
        placed: Json = {ORIGIN: list(marked.origin)} if any(marked.origin) else {}
        record = Record.make(
            key,
            asset.draft.reference,
            original_digest=asset.original_sha256,
            plan=mark.plan,
            extra={"settings": settings.to_json() | placed, **stamps_extra(committed.stamps)},
            copy=copy,
            registered_at=terms.registered_at,
        )
        shown, total = fidelity.view, fidelity.psnr_db
        if delivery.model is not asset.original.model:
            seen = psnr_by_view(asset.original.views.images, ground.cameras, marked, variant.at_view)
            shown, total = int(np.argmin(seen)), min(seen)
    rehearsed = 0.0 if asset.choice is None else asset.choice.rehearsal.usual_z
    report = EmbedReport(
        gaussians_in=len(asset.original.model),
        gaussians_out=len(marked),
        bits=bits,
        message=message_hex(committed.message),
        copy=copy,
        record_id=record.header.record_id,
        psnr_worst_view=fidelity.psnr_db,
        ssim_worst_view=fidelity.ssim,
        psnr_total_worst_view=total,
        predicted_z_render=predict_claim(plan.energies * ground.picture_scale, rehearsed),
        capacity_bits=owner.capacity,
        picture_bits=owner.pictured,
        chips=plan.layout.chips,
        grain=owner.settled.grain,
        device=settings.device,
        choice=None if asset.choice is None else asset.choice.report(),
        pruned=delivery.pruned,
        seconds=clock.total,
        seconds_by_stage=clock.seconds,
    )
    worst = SeenView(ground.cameras[shown], asset.original.views.images[shown])
    return Embedding(marked, record, settings, report, worst, asset.bank)


def _check_shared(earlier: Record, plan: Plan, asset: Asset) -> None:
    """Refuse a second owner's layer on one model: with a copy of each, both follow from their difference."""
    if not shares_layer(earlier, asset.draft.digest, asset.draft.key):
        return
    ours, arrays = plan
    same = shared_values(earlier.plan) == shared_values(ours) and set(arrays) == set(earlier.plan_arrays)
    if not (same and all(np.array_equal(earlier.plan_arrays[n], arrays[n]) for n in arrays)):
        raise second_watermark(earlier)
