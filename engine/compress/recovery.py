"""Recovery: what pruning leaves is fitted to the original's own renders, before anything is quantised or marked.

Centres, rotations, log scales and opacities move by Adam; colours stay: fitting them, too, gained nothing, nor did the
wavelet term of Eq 9. With a budget, pruning and recovery take turns (DESIGN 4.2).
"""

from collections.abc import Callable, Sequence
from copy import copy, deepcopy
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from engine.compress.config import CONFIG
from engine.compress.impact import ranks
from engine.compress.pruning import PruneConfig, Pruned, prune
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.adam import AdamMoments, adam_step
from engine.raster import Gradients, backward, draw, prepare_view, render, sh_colors
from engine.raster.cuda import CudaView

_CONFIG = CONFIG.recovery

Measure = Callable[[GaussianModel], float]
"""Worst key view's PSNR of a candidate against the original, dB."""

Tell = Callable[[float, float], None]
"""Called with the share of the work done, 0 to 1, and the PSNR by now, dB."""

_RATES = {
    "means": _CONFIG.mean_rate,
    "quats": _CONFIG.quat_rate,
    "log_scales": _CONFIG.scale_rate,
    "opacity_logits": _CONFIG.opacity_rate,
}


def recoverable(model: GaussianModel) -> bool:
    """Whether the rasterizer has gradients of its geometry: not of discs, nor of antialiased Gaussians."""
    return len(model) > 0 and not model.is_flat and not model.antialiased


def cost(gaussians: int, pixels: int) -> float:
    """Work of one step, in nanoseconds of one core."""
    return _CONFIG.per_gaussian * gaussians + _CONFIG.per_pixel * pixels


def sum_squares(model: GaussianModel, cameras: Sequence[Camera], weights: Float64 | None = None) -> Float64:
    """(N,) sum of w^2 over pixels and (weighted) views: what leaving each Gaussian out costs, to second order."""
    total = np.zeros(len(model))
    for camera, weight in zip(cameras, np.ones(len(cameras)) if weights is None else weights, strict=True):
        total += weight * prepare_view(model, camera).weights()[1]
    return total


@dataclass(frozen=True, eq=False)
class Target:
    """What is fitted to: renders of the original from views that are no key views."""

    cameras: Sequence[Camera]
    images: Sequence[npt.NDArray[np.float16]]  # (H, W, 3) each, 0 to 1
    work: float  # that may be spent on fitting to it, nanoseconds of one core
    device: str = "cpu"  # that draws what is fitted: "cpu" or "cuda"; as many steps on either

    @classmethod
    def of(cls, model: GaussianModel, cameras: Sequence[Camera], device: str = "cpu") -> "Target":
        """A model, seen by some cameras."""
        images = [np.clip(render(model, camera), 0.0, 1.0).astype(np.float16) for camera in cameras]
        return cls(cameras, images, work_for(len(model)), device)


def work_for(gaussians: int) -> float:
    """Work that a model of so many Gaussians is worth."""
    return min(_CONFIG.least_work + _CONFIG.work_each * gaussians, _CONFIG.most_work)


def views_for(gaussians: int, side: int) -> int:
    """To how many views of so many pixels a side a model is fitted: fewer where it is slow to draw."""
    affordable = _CONFIG.looking * work_for(gaussians) / cost(gaussians, side**2)
    return int(np.clip(affordable, _CONFIG.least_views, _CONFIG.views))


class Recovery:
    """A fit in progress; on the CPU the same bits whatever the number of threads."""

    def __init__(self, model: GaussianModel, target: Target, goal_db: float = 0.0, left: float | None = None) -> None:
        self._base = model  # colours, centres to start from, and where the bounds lie
        self.kept = np.arange(len(model), dtype=np.int32)  # (n,) which of its Gaussians are left
        self._target = target
        self._width = np.exp(np.median(model.log_scales, axis=1, keepdims=True))  # (N, 1) a Gaussian's own middle one
        # What Adam moves: centres by their offset in those widths
        self._moving = {name: getattr(model, name).copy() for name in _RATES} | {"means": np.zeros_like(model.means)}
        self._moments = {name: AdamMoments.zeros(array) for name, array in self._moving.items()}
        self._gradients = Gradients.empty(model, with_sh=False)
        self._rng = np.random.default_rng(_CONFIG.seed)
        self._queue = list(self._rng.permutation(len(target.cameras)))
        self._errors = np.ones(len(target.cameras))  # squared, of each view when it was last seen
        self._steps = 0
        # Factor on all rates: steps as large as the error that is aimed at
        self._pace = min(1.0, 10 ** ((_CONFIG.full_pace_db - goal_db) / 20.0))
        self.left = target.work if left is None else left  # of it

    @property
    def done(self) -> float:
        """Share of the work that is done."""
        return 1.0 - max(self.left, 0.0) / self._target.work

    @property
    def model(self) -> GaussianModel:
        """As fitted by now, within its bounds."""
        base, moving = self._base, self._moving
        reach = np.maximum(np.abs(base.opacity_logits), np.float32(_CONFIG.opacity_logit))
        np.clip(moving["opacity_logits"], -reach, reach, out=moving["opacity_logits"])
        stretch = np.float32(_CONFIG.stretch)
        np.clip(moving["log_scales"], base.log_scales - stretch, base.log_scales + stretch, out=moving["log_scales"])
        moving["quats"] /= np.maximum(np.linalg.norm(moving["quats"], axis=1, keepdims=True), np.float32(1e-12))
        means = base.means + self._width * moving["means"]
        return base.with_(**{name: array.copy() for name, array in moving.items()} | {"means": means})

    @property
    def rounds_left(self) -> int:
        """For how many more rounds there is work left."""
        pixels = max(camera.width * camera.height for camera in self._target.cameras)
        return int(self.left // (sum(_CONFIG.round) * cost(len(self._base), pixels)))

    def round(self) -> GaussianModel:
        """Steps at full rates, then at smaller ones, without which some decibels stay away; gives the model after
        them."""
        for steps, pace in zip(_CONFIG.round, _CONFIG.paces, strict=True):
            for _ in range(steps):
                self._step(pace * self._pace)
        return self.model

    def _step(self, pace: float) -> None:
        views = len(self._target.cameras)
        if not self._queue:
            share = _CONFIG.hard_share
            odds = (1.0 - share) / views + share * self._errors / self._errors.sum()
            self._queue = list(self._rng.choice(views, views, p=odds / odds.sum()))
        k = int(self._queue.pop())
        camera, moving = self._target.cameras[k], self._moving
        model = self._base.with_(**moving | {"means": self._base.means + self._width * moving["means"]})
        self.left -= cost(len(model), camera.width * camera.height)
        self._steps += 1
        colors, gradients = sh_colors(model.sh, model.means, camera.position.astype(np.float32)), self._gradients
        if self._target.device == "cuda":
            CudaView(model, camera).gradients(colors, partial(self._pull, k), gradients)
        else:
            rendering = draw(model, camera, colors=colors)
            backward(rendering, self._pull(k, rendering.image), out=gradients)
        np.multiply(gradients.means, self._width, out=gradients.means)
        for name, rate in _RATES.items():
            gradient = getattr(gradients, name)
            if not np.isfinite(gradient.sum()):  # one absurd Gaussian must not spoil the others
                np.nan_to_num(gradient, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
            adam_step(moving[name], gradient, self._moments[name], pace * rate, self._steps)

    def _pull(self, k: int, image: Float32) -> Float32:
        """(H, W, 3) derivative of the absolute error of view k, rounded off near zero (Huber); its scale is nothing to
        Adam."""
        gap = np.clip(image, 0.0, 1.0)
        gap -= self._target.images[k]
        self._errors[k] = float(np.mean(np.square(gap), dtype=np.float64)) + 1e-12
        gap /= np.float32(_CONFIG.knee)
        return np.clip(gap, -1.0, 1.0, out=gap)

    def thinned(self, share: float) -> "Recovery":
        """The fit going on with this share of the Gaussians, those that the views, weighed by their errors, would miss
        most; this one stays as it is."""
        keep = ranks(sum_squares(self.model, self._target.cameras, self._errors)) > 1.0 - share
        other = copy(self)
        other._base, other.kept, other._width = self._base.take(keep), self.kept[keep], self._width[keep]
        other._moving = {name: array[keep] for name, array in self._moving.items()}
        other._moments = {name: AdamMoments(m.first[keep], m.second[keep]) for name, m in self._moments.items()}
        other._gradients = Gradients.empty(other._base, with_sh=False)
        other._rng, other._queue, other._errors = deepcopy((self._rng, self._queue, self._errors))
        return other


def fit(recovery: Recovery, measure: Measure, tell: Tell) -> tuple[GaussianModel, float]:
    """Fit until the worst view gains no more, or the work is done; gives the best by then and its PSNR."""
    best, best_db, gain_db = recovery.model, measure(recovery.model), np.inf
    while recovery.rounds_left and gain_db >= _CONFIG.least_gain_db:
        model = recovery.round()
        psnr = measure(model)
        gain_db = psnr - best_db
        if gain_db > 0.0:
            best, best_db = model, psnr
        tell(recovery.done, best_db)
    return best, best_db


def prune_and_fit(
    model: GaussianModel,
    impact: Float64,
    measure: Measure,
    radius: float,
    config: PruneConfig,
    target: Target | None,
    fewest: int,
    tell: Tell,
) -> Pruned:
    """Prune below the budget, fit what is left, and go on by turns while it comes back above, to `fewest` Gaussians or
    a quarter of them; other parameters as of `prune`.

    The answer is that of `prune` where there is no target, or no fit reaches the budget.
    """
    if config.budget_db is None or target is None:
        return prune(model, impact, measure, radius, config)
    left, fewest = target.work, min(fewest, len(model) // 4)
    for head in _CONFIG.heads_db:
        pruned = start = prune(model, impact, measure, radius, replace(config, budget_db=config.budget_db - head))
        if len(start.model) == len(model):  # too few to prune
            return start
        if len(start.model) < fewest:
            rows = np.sort(np.argsort(-impact, kind="stable")[:fewest]).astype(np.int32)
            start = Pruned(model.take(rows), rows, -np.inf, 0)
        recovery = Recovery(start.model, target, config.budget_db, left)
        best = _by_turns(recovery, start, measure, config.budget_db, fewest, tell)
        if best is not None:
            return best
        left = recovery.left
    return pruned


def _by_turns(
    recovery: Recovery, start: Pruned, measure: Measure, budget_db: float, fewest: int, tell: Tell
) -> Pruned | None:
    """The fewest Gaussians by which a fit reaches the budget; None where none does."""
    best: Pruned | None = None
    at, before = recovery, -np.inf  # `recovery` is the last fit that reached the budget
    # Of a model that is pruned to the budget itself, since fits of fewer did not do, hardly any are to spare
    slope = _CONFIG.slope_db if start.psnr_db < budget_db else _CONFIG.slopes_db[1]
    while at.rounds_left:
        fitted = at.round()
        psnr = measure(fitted)
        tell(at.done, psnr)
        gained, before = psnr - before, psnr
        if best is not None and len(at.kept) < len(recovery.kept) and psnr < best.psnr_db:
            slope = (best.psnr_db - psnr) / np.log(len(recovery.kept) / len(at.kept))
        if psnr >= budget_db:
            best, recovery = Pruned(fitted, start.kept[at.kept], psnr, start.merged), at
        if best is None:  # rounds gain less and less: would as much again in each that is left do?
            stays = psnr + gained * at.rounds_left >= budget_db
        else:
            stays = budget_db - _CONFIG.near_db <= psnr < budget_db and gained == np.inf
        if best is not None and not stays:
            share = np.exp((budget_db - best.psnr_db) / np.clip(slope, *_CONFIG.slopes_db))
            share = max(share, _CONFIG.least_share, fewest / len(recovery.kept))
            if share <= _CONFIG.most_share:
                recovery.left = at.left
                at, before = recovery.thinned(share), -np.inf
                continue
            stays = at is recovery and len(at.kept) > fewest  # what is near the budget may gain, and lose more then
        if not stays or gained < _CONFIG.least_gain_db:
            break
    return best
