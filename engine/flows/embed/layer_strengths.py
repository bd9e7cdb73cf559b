"""How strong each layer of the mark is, settled before a chip is drawn (DESIGN 4.5, 4.9).

One budget of fidelity holds both layers. The grain takes what it needs up to a fixed part of it, the tint the rest:
errors of independent signs add in squares, so each is measured alone. Of each a part is the copy layer's, where there
is one: half of the grain's squared error, a quarter of the tint's, which pictures need for the owner's claim. Signs
are public ones; those of the key show as much within a few tenths of a decibel, and where they show more, strengths
are lowered and chips drawn anew.
"""

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from engine.flows.embed.config import CONFIG
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.variant import PLAIN, AtView, Variant
from engine.flows.views.view_set import ViewSet
from engine.kernels.thread_crew import thread_count
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.image_metrics import psnr, ssim
from engine.raster import render
from engine.watermark.copy_layer import CopyLayer
from engine.watermark.grain import ATTRIBUTES, Grain, roughen, units
from engine.watermark.lattice import FREE, Lattices
from engine.watermark.planning import Plan, scaled
from engine.watermark.spreading import public_signs, public_values

_CONFIG = CONFIG.strength


@dataclass(frozen=True)
class Fidelity:
    """What the worst view shows, or is to show."""

    psnr_db: float
    ssim: float
    view: int = field(default=0, kw_only=True, compare=False)  # index of the view with that PSNR

    def meets(self, other: "Fidelity") -> bool:
        """Whether it is at least as good in both."""
        return self.psnr_db >= other.psnr_db and self.ssim >= other.ssim

    def room_to(self, other: "Fidelity") -> float:
        """By how much the amplitude of what is seen may be multiplied until it shows as much as another: PSNR falls by
        20 log10 of the factor, 1 - SSIM grows with its square."""
        by_psnr = 10.0 ** ((self.psnr_db - other.psnr_db) / 20.0)
        return float(min(by_psnr, np.sqrt((1.0 - other.ssim) / max(1.0 - self.ssim, 1e-12))))


@dataclass(frozen=True)
class Strength(Fidelity):
    """Factor on the displacement, and what the worst view then measures."""

    factor: float


def add_dc(sh: Float32, displacement: Float32) -> Float32:
    """(N, K, 3) colours with the DC coefficients displaced by (N, 3), or all of them by (N, 3K)."""
    marked = sh.copy()
    marked[:, : displacement.shape[1] // 3] += displacement.reshape(len(sh), -1, 3)
    return marked


def first_guess(energies: Float64, cameras: Sequence[Camera], psnr_db: float) -> float:
    """Factor at which the view of most energy, of a `Plan`'s (V, C), would have this PSNR if no chips met in pixels."""
    pixels = 3.0 * cameras[0].width * cameras[0].height
    most = max(float(energies.sum(axis=1).max()), 1e-30)
    return 10 ** (-psnr_db / 20.0) * float(np.sqrt(pixels / most))


def solve_strength(views: ViewSet, displacement: Float32, psnr_db: float, least_ssim: float, start: float) -> Strength:
    """Largest factor at which the worst view keeps both targets.

    Its measurements come from the final renders; PSNR lies within 0.05 dB above its target unless SSIM limits.

    Parameters
    ----------
    views : ViewSet
        Of the unmarked model.
    displacement : (N, 3) float32
        At factor 1.
    psnr_db, least_ssim : float
        Targets against the unmarked render.
    start : float
        First guess of the factor.
    """
    factor, above, best = start, np.inf, None
    aim = Fidelity(psnr_db + 0.02, 1.0 - 0.996 * (1.0 - least_ssim))  # a hair above both
    for number in range(_CONFIG.rounds):
        found = _measure(views, displacement, factor)
        if not np.isfinite(found.psnr_db):  # nothing in sight changes: any strength will do
            return found
        step = found.room_to(aim)
        if found.psnr_db >= psnr_db and found.ssim >= least_ssim:
            if step < 1.006:
                return found
            best = found if best is None or factor > best.factor else best
        else:
            above = min(above, factor)
        below = best.factor if best is not None else 0.0
        if below > 0.0 and above < 1.006 * below:
            break
        factor *= step
        if number >= _CONFIG.patience and below > 0.0 and np.isfinite(above):
            factor = float(np.sqrt(below * above))
    return best if best is not None else _measure(views, displacement, factor)


def _measure(views: ViewSet, displacement: Float32, factor: float) -> Strength:
    sh = add_dc(views.model.sh, np.float32(factor) * displacement)
    found = worst_of(compare(views.images, (views.render(k, sh) for k in range(len(views.images)))))
    return Strength(found.psnr_db, found.ssim, factor, view=found.view)


def compare(images: Sequence[Float32], seen: Iterable[Float32]) -> list[Fidelity]:
    """Pictures (H, W, 3) against images, each by itself; while one is compared, the next is drawn."""
    with ThreadPoolExecutor(max_workers=thread_count()) as pool:
        found = [pool.submit(_compare, image, picture) for image, picture in zip(images, seen, strict=True)]
        return [each.result() for each in found]


def _compare(image: Float32, picture: Float32) -> Fidelity:
    return Fidelity(psnr(image, picture), ssim(image, picture))


def worst_of(views: Sequence[Fidelity]) -> Fidelity:
    """The least of both among views."""
    worst = min(range(len(views)), key=lambda k: views[k].psnr_db)
    return Fidelity(views[worst].psnr_db, min(view.ssim for view in views), view=worst)


NO_GRAIN = Grain()


@dataclass(frozen=True)
class Grained:
    """A grain, and what the worst view shows of it alone."""

    grain: Grain
    spent: Fidelity


@dataclass(frozen=True, eq=False)
class Settled:
    """Both layers at the strength at which they are embedded."""

    plan: Plan
    grain: Grain  # the owner's
    tint: Fidelity  # what the tint alone keeps
    copy_grain: Grain = NO_GRAIN  # that of a copy layer

    @property
    def copies(self) -> CopyLayer | None:
        """What tells copies apart, where anything does."""
        return None if self.plan.copies is None else CopyLayer(self.plan.copies, self.copy_grain)

    def lowered(self, found: Fidelity, wanted: Fidelity) -> "Settled":
        """Weaker by as much as the worst view misses, and a hair more."""
        factor = 0.997 * min(found.room_to(wanted), 1.0)
        return Settled(self.plan.times(factor), self.grain.times(factor), self.tint, self.copy_grain.times(factor))


def settle(views: ViewSet, plan: Plan, config: EmbedConfig, grained: Grained) -> Settled:
    """Strengths at which the worst view keeps PSNR and SSIM.

    Parameters
    ----------
    views : ViewSet
        Of the unmarked model as delivered.
    plan : Plan
        At unit strength.
    grained : Grained
        The second layer, from `settle_grain`, which all copies share.
    """
    wanted, spent = _aim(config), grained.spent
    error = 10.0 ** (-wanted.psnr_db / 10.0) - 10.0 ** (-spent.psnr_db / 10.0)
    left = Fidelity(-10.0 * float(np.log10(error)), wanted.ssim + (1.0 - spent.ssim))
    displacement = plan.layout.displace(plan.layout.amplitudes * public_signs(plan.layout.chips))
    guess = first_guess(plan.energies, views.cameras, left.psnr_db)
    grain, own = grained.grain, NO_GRAIN
    if plan.copies is not None:
        plan, copied = _with_copies(views, plan, displacement, config.plan.copy_tint, guess)
        displacement = displacement + copied
        grain, own = (grain.times(math.sqrt(part)) for part in (1.0 - config.plan.copy_grain, config.plan.copy_grain))
    strength = solve_strength(views, displacement, left.psnr_db, left.ssim, guess)
    return Settled(plan.times(strength.factor), grain, left, own)


def _with_copies(views: ViewSet, plan: Plan, owner: Float32, share: float, factor: float) -> tuple[Plan, Float32]:
    """The plan whose copy layer has this share of the tint's squared error, as views show it near the strength to come;
    and (N, D) what such a layer of public values displaces colours by."""
    assert plan.copies is not None
    layout = plan.copies
    usual = layout.displace(layout.amplitudes * public_values(layout.chips))
    errors = [0.0, 0.0]
    for number, displacement in enumerate((owner, usual)):
        sh = add_dc(views.model.sh, np.float32(factor) * displacement)
        for k, image in enumerate(views.images):
            errors[number] += float(np.square(views.render(k, sh) - image, dtype=np.float64).sum())
    times = math.sqrt(share / (1.0 - share) * errors[0] / errors[1]) if errors[1] > 0 else 1.0
    return replace(plan, copies=scaled(layout, times)), np.float32(times) * usual


def _aim(config: EmbedConfig) -> Fidelity:
    return Fidelity(config.psnr_db + _CONFIG.margin_db, config.ssim)


def settle_grain(views: ViewSet, config: EmbedConfig, variant: Variant = PLAIN, lattices: Lattices = FREE) -> Grained:
    """The wanted grain, or as much of it as its part of the budget allows, and what that costs as measured.

    There is none where neither centres nor sizes have room for it.
    """
    wanted, model, at_view = _aim(config), views.model, variant.at_view
    center, scale = config.plan.grain_center * variant.free_centers, config.plan.grain_scale * variant.free_sizes
    size = float(np.median(units(model.log_scales[:: max(1, len(model) // _CONFIG.sample)])))
    grain = Grain(
        center if lattices.step("means") <= _CONFIG.coarse * center * size else 0.0,
        scale if lattices.step("log_scales") <= _CONFIG.coarse * scale else 0.0,
    )
    if not grain.there:
        return Grained(NO_GRAIN, Fidelity(np.inf, 1.0))
    signs = public_signs(ATTRIBUTES * len(model)).astype(np.float32).reshape(-1, ATTRIBUTES)
    allowed = Fidelity(wanted.psnr_db + _CONFIG.grain_room_db, 1.0 - _CONFIG.grain_ssim_share * (1.0 - wanted.ssim))
    factor, growth = 1.0, 1.0
    tried: list[tuple[float, float, Fidelity]] = []  # factor, log of what it may be multiplied with, what was found
    chosen = list(range(len(views.cameras)))
    for _ in range(_CONFIG.grain_rounds):
        rough = lattices.onto(model, roughen(model, grain.times(factor), signs), bytes(32))
        each = measure_each(views, rough, at_view, chosen)
        found = worst_of(each)
        if not tried:  # the views that show it worst decide, and are enough from then on
            worst = min(each, key=lambda view: view.psnr_db), min(each, key=lambda view: view.ssim)
            chosen = sorted({each.index(view) for view in worst})
        room = math.log(found.room_to(allowed)) if np.isfinite(found.psnr_db) else math.inf
        tried.append((factor, room, found))
        if -_CONFIG.close < room < _CONFIG.waste or (room > 0.0 and factor == 1.0):
            break
        if len(tried) > 1:
            (x0, y0, _), (x1, y1, _) = tried[-2:]
            growth = min(max((y1 - y0) / math.log(x0 / x1), _CONFIG.least_growth), 1.0)
        factor = min(factor * math.exp(room / growth), 1.0)
    # The most of what may stay, else the least.
    close = -_CONFIG.close
    factor, _, spent = max(tried, key=lambda each: (each[1] > close, each[0] if each[1] > close else -each[0]))
    return Grained(grain.times(factor), spent)


def measure_each(
    views: ViewSet, model: GaussianModel, at_view: AtView | None = None, chosen: Sequence[int] | None = None
) -> list[Fidelity]:
    """What each view, or each of those chosen, shows of another model, whatever of it differs, against its image."""
    chosen = range(len(views.cameras)) if chosen is None else chosen
    seen = (render(model if at_view is None else at_view(model, k), views.cameras[k]) for k in chosen)
    return compare([views.images[k] for k in chosen], seen)


def measure(views: ViewSet, model: GaussianModel, at_view: AtView | None = None) -> Fidelity:
    """What the worst of them shows."""
    return worst_of(measure_each(views, model, at_view))
