"""How strong each layer of the mark is, settled before a chip is drawn (DESIGN 4.5, 4.9).

One budget of fidelity holds both layers. The grain takes what it needs up to a fixed part of it, the tint the rest:
errors of independent signs add in squares, so each is measured alone. Signs are public ones; those of the key show as
much within a tenth of a decibel, and where they show more, strengths are lowered and chips drawn anew.
"""

import math
from dataclasses import dataclass

import numpy as np

from engine.model import GaussianModel
from engine.pipeline.profiles import EmbedConfig
from engine.pipeline.scenes import ViewSet
from engine.pipeline.strength import Fidelity, first_guess, solve_strength, worst_of
from engine.pipeline.variant import AtView
from engine.raster import render
from engine.watermark.grain import ATTRIBUTES, Grain, roughen
from engine.watermark.planning import Plan
from engine.watermark.spreading import public_signs

GRAIN_ROOM_DB = 6.0
"""How far above the asked PSNR the grain alone stays: a quarter of the squared error. It has chips enough; what it
takes away is evidence of pictures."""
GRAIN_SSIM_SHARE = 0.25
"""Of what SSIM may lose; SSIM sees moved edges sooner than squared error does."""
GRAIN_ROUNDS = 4
"""Most measurements of the grain."""
LEAST_GROWTH = 0.3
"""Errors grow more slowly than the grain where a hair's breadth turns the order of Gaussians round (playbot: to the
power of a half); the exponent is taken from the last two measurements, and not below this."""
CLOSE = 0.05
"""A grain that exceeds its part of the budget by less than this, in log of amplitude, stays."""
WASTE = 0.3
"""And one that could grow by less."""
MARGIN_DB = 0.05
"""Aimed at above the target, for chips that meet less luckily than the public ones."""


@dataclass(frozen=True, eq=False)
class Settled:
    """Both layers at the strength at which they are embedded."""

    plan: Plan
    grain: Grain
    tint: Fidelity  # what the tint alone keeps

    def lowered(self, found: Fidelity, wanted: Fidelity) -> "Settled":
        """Weaker by as much as the worst view misses, and a hair more."""
        factor = 0.997 * min(found.room_to(wanted), 1.0)
        return Settled(self.plan.times(factor), self.grain.times(factor), self.tint)


def settle(views: ViewSet, plan: Plan, config: EmbedConfig, *, grainy: bool) -> Settled:
    """Strengths at which the worst view keeps PSNR and SSIM.

    Parameters
    ----------
    views : ViewSet
        Of the unmarked model as delivered.
    plan : Plan
        At unit strength.
    grainy : bool
        Whether there is a second layer.
    """
    wanted = Fidelity(config.psnr_db + MARGIN_DB, config.ssim)
    grain, spent = Grain(), Fidelity(np.inf, 1.0)
    if grainy:
        grain, spent = _settle_grain(views, Grain(config.plan.grain_center, config.plan.grain_scale), wanted)
    error = 10.0 ** (-wanted.psnr_db / 10.0) - 10.0 ** (-spent.psnr_db / 10.0)
    left = Fidelity(-10.0 * float(np.log10(error)), wanted.ssim + (1.0 - spent.ssim))
    displacement = plan.layout.displace(plan.layout.amplitudes * public_signs(plan.layout.chips))
    guess = first_guess(plan.energies, views.cameras, left.psnr_db)
    strength = solve_strength(views, displacement, left.psnr_db, left.ssim, guess)
    return Settled(plan.times(strength.factor), grain, left)


def _settle_grain(views: ViewSet, grain: Grain, wanted: Fidelity) -> tuple[Grain, Fidelity]:
    """The asked grain, or as much of it as its part of the budget allows, and what that costs as measured."""
    model = views.model
    signs = public_signs(ATTRIBUTES * len(model)).astype(np.float32).reshape(-1, ATTRIBUTES)
    allowed = Fidelity(wanted.psnr_db + GRAIN_ROOM_DB, 1.0 - GRAIN_SSIM_SHARE * (1.0 - wanted.ssim))
    factor, growth = 1.0, 1.0
    tried: list[tuple[float, float, Fidelity]] = []  # factor, log of what it may be multiplied with, what was found
    for _ in range(GRAIN_ROUNDS):
        found = measure(views, roughen(model, grain.times(factor), signs))
        room = math.log(found.room_to(allowed)) if np.isfinite(found.psnr_db) else math.inf
        tried.append((factor, room, found))
        if -CLOSE < room < WASTE or (room > 0.0 and factor == 1.0):
            break
        if len(tried) > 1:
            (x0, y0, _), (x1, y1, _) = tried[-2:]
            growth = min(max((y1 - y0) / math.log(x0 / x1), LEAST_GROWTH), 1.0)
        factor = min(factor * math.exp(room / growth), 1.0)
    # The most of what may stay, else the least.
    factor, _, spent = max(tried, key=lambda each: (each[1] > -CLOSE, each[0] if each[1] > -CLOSE else -each[0]))
    return grain.times(factor), spent


def measure(views: ViewSet, model: GaussianModel, at_view: AtView | None = None) -> Fidelity:
    """Worst view of another model, whatever of it differs, against the images of these views."""
    seen = (render(model if at_view is None else at_view(model, k), camera) for k, camera in enumerate(views.cameras))
    return worst_of(views.images, seen)
