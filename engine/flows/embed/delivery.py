"""What is delivered before it is marked: as many Gaussians, SH bands and codes as the scene needs, no more.

The paper densifies while it trains. A finished model is densified once, where there is texture, in which a mark is hard
to see: the Gaussians of the greatest W^freq are split.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from engine.compress.code_fit import fit_codes, fit_colors
from engine.compress.config import CONFIG as COMPRESS
from engine.compress.hvq import Stage, decode_stages, learn_residual_stage
from engine.compress.impact import frequency_impact, paper_impact, sh_curvature
from engine.compress.pruning import Pruned as Fitted
from engine.compress.pruning import drop_unseen_bands, prune_at
from engine.compress.recovery import Recovery, Target, Tell, fit, prune_and_fit, recoverable, sum_squares, views_for
from engine.flows.embed.config import CONFIG
from engine.flows.embed.planning_basis import Groundwork, color_weights
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.progress import Clock
from engine.flows.views.view_set import ViewSet, worst_psnr_against
from engine.model import Camera, Float64, GaussianModel
from engine.numerics.plain import Json, Report
from engine.numerics.similarity import quaternion_to_rotation
from engine.raster import render

_CONFIG = CONFIG.plan
_RECOVERY, _FIT = COMPRESS.recovery, COMPRESS.code_fit


@dataclass(frozen=True, eq=False)
class Pruned(Report):
    """What was taken off a model before it is marked; None: nothing was, or there is no such step."""

    psnr_pruned_worst_view: float | None = None  # dB
    merged: int | None = None  # Gaussians that went into others
    budget_db: float | None = None
    sh_bands_dropped: int | None = None
    densified: int | None = None  # Gaussians added

    def to_json(self) -> Json:
        """Plain values of what is known."""
        return {name: value for name, value in super().to_json().items() if value is not None}


@dataclass(frozen=True, eq=False)
class Delivery:
    """A model as it would be delivered, unmarked, and what it is marked with."""

    settings: EmbedConfig
    ground: Groundwork  # of the pruned model
    model: GaussianModel
    stages: tuple[Stage, ...]  # public cells, and what refines them
    views: ViewSet  # of `model`
    pruned: Pruned


def deliver(original: Groundwork, settings: EmbedConfig, clock: Clock) -> Delivery:
    """Prune and quantise as the settings say."""
    with clock.stage("prune"):
        slim, pruned = slim_down(original, settings, clock)
    with clock.stage("quantize"):
        # What is left is quantised as these settings say, under whichever ones it was looked at.
        ground = (replace(original, config=settings) if settings.thins else original).of(slim, clock)
        model, stages = unmarked_delivery(original, ground, settings, _tell(clock))
        return Delivery(settings, ground, model, stages, ground.views_of(model, clock), pruned)


def slim_down(original: Groundwork, config: EmbedConfig, clock: Clock) -> tuple[GaussianModel, Pruned]:
    """Prune Gaussians and SH bands within the owner's budget, or as the paper does, fit what is left to the original's
    renders, and report on it.

    With neither the model stays as it is and there is no report.
    """
    if config.paper.tau_base > 0 or config.paper.densify > 0:
        return _as_the_paper(original, config, clock)
    budget, model, cameras = config.prune.budget_db, original.model, original.cameras
    if budget is None:
        return model, Pruned()
    (target, measure), worth = _sights(original, config), _worth(original, config)
    if config.prune.sh_degree < model.sh_degree:
        model = model.with_(sh=np.ascontiguousarray(model.sh[:, : (config.prune.sh_degree + 1) ** 2]))
        if target is not None:
            model = fit_colors(model, _seen_by_others(original), _tell(clock))
    if target is not None and config.prune.rank == "error":
        worth = worth + sum_squares(model, target.cameras)  # what key views alone do not show is seen elsewhere
    pixels = sum(c.width * c.height for c in cameras)
    curvature = sh_curvature(model, original.views.views, cameras)
    thin, dropped = drop_unseen_bands(model, curvature, pixels, _CONFIG.band_share * 10 ** (-budget / 10.0))

    def pruned(candidate: GaussianModel) -> Fitted:
        radius, fewest = original.extent.radius, round(_CONFIG.left_a_code * config.plan.codes)
        return prune_and_fit(candidate, worth, measure, radius, config.prune, target, fewest, _tell(clock))

    found = pruned(thin)
    if found.psnr_db < budget:  # the bands alone broke a very tight budget
        dropped, found = 0, pruned(model)
    return found.model, Pruned(found.psnr_db, found.merged, budget, dropped)


def _sights(original: Groundwork, config: EmbedConfig) -> tuple[Target | None, Callable[[GaussianModel], float]]:
    """What pruned Gaussians are fitted to, None where they cannot be; and the PSNR of the worst view of a candidate.

    Some views that were neither fitted to nor are the key's are held to the budget, too.
    """
    model, side, held = original.model, min(config.view_size, _RECOVERY.side), _RECOVERY.held_out
    fitted: list[Camera] = []
    if config.prune.recover and recoverable(model):
        fitted = original.unseen(views_for(len(model), side) + held, side, np.random.default_rng(_RECOVERY.seed))
    if len(fitted) < _RECOVERY.least_views:  # of the owner's cameras few are left
        return None, worst_psnr_against(original.views.images, original.cameras)
    others = [fitted.pop(k) for k in np.linspace(len(fitted) - 1, 0, held).astype(int)]
    images = [*original.views.images, *(render(model, camera) for camera in others)]
    return Target.of(model, fitted, config.device), worst_psnr_against(images, [*original.cameras, *others])


def _seen_by_others(original: Groundwork) -> Target:
    """What colors are fitted to: renders from views all around that are no key views."""
    cameras = original.unseen(_FIT.views, _FIT.side, np.random.default_rng(_RECOVERY.seed))
    return Target.of(original.model, cameras)


def _tell(clock: Clock) -> Tell:
    return lambda share, psnr_db: clock.advance(share, f"{psnr_db:.1f} dB")


def _worth(original: Groundwork, config: EmbedConfig) -> Float64:
    """(N,) what Gaussians are ranked by when some must go."""
    paper = config.prune.rank == "paper"
    return paper_impact(original.model, original.impact) if paper else original.impact.squared


def _as_the_paper(original: Groundwork, config: EmbedConfig, clock: Clock) -> tuple[GaussianModel, Pruned]:
    """Pruned at a fixed threshold (Eq 5), merged, densified where W^freq is greatest, and fitted."""
    model, radius = original.model, original.extent.radius
    slim, kept, merged = model, np.arange(len(model), dtype=np.int32), 0
    if config.paper.tau_base > 0:
        slim, kept, merged = prune_at(model, _worth(original, config), config.paper.tau_base, radius, config.prune)
    dense = densify(slim, frequency_impact(model, original.impact)[kept], config.paper.densify)
    target, measure = _sights(original, config)
    if target is None:
        return dense, Pruned(measure(dense), merged, densified=len(dense) - len(slim))
    fitted, psnr_db = fit(Recovery(dense, target), measure, _tell(clock))
    return fitted, Pruned(psnr_db, merged, densified=len(dense) - len(slim))


def unmarked_delivery(
    original: Groundwork, ground: Groundwork, config: EmbedConfig, tell: Tell
) -> tuple[GaussianModel, tuple[Stage, ...]]:
    """The unmarked model as delivered: that of `ground` itself ("fidelity"), or the sum of its code vectors
    ("compact").

    "compact" fits them to the original's renders, and learns residual stages, until the worst view keeps `compact_db`
    against the original (with room for the mark), up to `most_stages`: as many codes as the scene needs.
    """
    model, stages = ground.model, ground.stages
    if config.output == "fidelity":
        return model, stages
    measure = worst_psnr_against(original.views.images, original.cameras)
    goal, target = config.compact_db + _CONFIG.mark_room_db, None
    weights = color_weights(model, ground.impact, by_frequency=config.paper.frequency)
    while True:
        compact = model.with_(sh=decode_stages(stages))
        psnr, last = measure(compact), len(stages) > _CONFIG.most_stages
        if config.prune.recover and psnr < goal and (last or psnr >= goal - _CONFIG.fit_gain_db):
            target = target or _seen_by_others(original)
            fitted = fit_codes(model, stages, target, tell)
            better = model.with_(sh=decode_stages(fitted))
            if measure(better) >= (psnr if last else goal):
                return better, fitted
        if psnr >= goal or last:
            return compact, stages
        residual = (model.sh - compact.sh).reshape(len(model), -1)
        number = len(stages)
        stages = (*stages, learn_residual_stage(residual, weights, 1024, config.quantize, seed=number))


def densify(model: GaussianModel, worth: Float64, share: float) -> GaussianModel:
    """The model with a share of its Gaussians, those of the greatest worth (N,), split in two along their longest axis.

    Both halves keep the colour and, together, the first two moments; where they overlap they are as opaque as the
    whole. One half takes the whole's row, the other stands at the end.
    """
    count = round(share * len(model))
    if count == 0:
        return model
    rows = np.sort(np.argsort(-worth, kind="stable")[:count])
    axis = model.log_scales[rows].argmax(axis=1)
    along = quaternion_to_rotation(model.quats[rows])[np.arange(count), :, axis]  # (count, 3)
    step = _CONFIG.apart * np.exp(model.log_scales[rows, axis].astype(np.float64))[:, None] * along
    log_scales, logits = model.log_scales.copy(), model.opacity_logits.copy()
    log_scales[rows, axis] += np.float32(0.5 * np.log(1.0 - _CONFIG.apart**2))
    clear = np.sqrt(np.maximum(1.0 - model.opacities[rows].astype(np.float64), 1e-12))  # of each half
    logits[rows] = np.log(np.maximum(1.0 - clear, 1e-12) / clear)
    means = model.means.copy()
    means[rows] = model.means[rows] - step
    first = model.with_(means=means, log_scales=log_scales, opacity_logits=logits)
    every = np.concatenate([np.arange(len(model)), rows])
    both = first.take(every)
    means = both.means.copy()
    means[len(model) :] = model.means[rows] + step
    return both.with_(means=means)
