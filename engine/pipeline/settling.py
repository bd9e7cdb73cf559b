"""How strong each layer of the mark is, settled before a chip is drawn (DESIGN 4.5, 4.9).

One budget of fidelity holds both layers. The grain takes what it needs up to a fixed part of it, the tint the rest:
errors of independent signs add in squares, so each is measured alone. Signs are public ones; those of the key show as
much within a tenth of a decibel, and where they show more, strengths are lowered and chips drawn anew.
"""

from dataclasses import dataclass, replace

import numpy as np

from engine.model import GaussianModel
from engine.numerics.image_metrics import psnr, ssim
from engine.pipeline.profiles import EmbedConfig
from engine.pipeline.scenes import ViewSet
from engine.pipeline.strength import Fidelity, first_guess, solve_strength
from engine.pipeline.variant import AtView
from engine.raster import render
from engine.watermark.grain import ATTRIBUTES, Grain, roughen
from engine.watermark.planning import Plan
from engine.watermark.spreading import public_signs

GRAIN_ROOM_DB = 9.0
"""How far above the asked PSNR the grain alone stays: an eighth of the squared error. It has chips enough; what it
takes away is evidence of pictures."""
GRAIN_SSIM_SHARE = 0.25
"""Of what SSIM may lose; SSIM sees moved edges sooner than squared error does."""
MARGIN_DB = 0.1
"""Aimed at above the target, for chips that meet less luckily than the public ones."""
EVERY = 2
"""Of the key views every second one measures the grain; the whole mark is measured in all."""


@dataclass(frozen=True, eq=False)
class Settled:
    """Both layers at the strength at which they are embedded."""

    plan: Plan
    grain: Grain
    tint: Fidelity  # what the tint alone keeps

    def lowered(self, found: Fidelity, wanted: Fidelity) -> "Settled":
        """Weaker by as much as the worst view misses, and a hair more."""
        by_psnr = 10.0 ** ((found.psnr_db - wanted.psnr_db) / 20.0)
        by_ssim = np.sqrt((1.0 - wanted.ssim) / max(1.0 - found.ssim, 1e-12))
        factor = 0.997 * float(min(by_psnr, by_ssim, 1.0))
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
    """The asked grain, or as much of it as its part of the budget allows, and what that costs."""
    model = views.model
    signs = public_signs(ATTRIBUTES * len(model)).astype(np.float32).reshape(-1, ATTRIBUTES)
    rough = measure(
        replace(views, cameras=views.cameras[::EVERY], images=views.images[::EVERY]), roughen(model, grain, signs)
    )
    if not np.isfinite(rough.psnr_db):  # nothing in sight moves
        return grain, Fidelity(np.inf, 1.0)
    by_psnr = 10.0 ** ((rough.psnr_db - wanted.psnr_db - GRAIN_ROOM_DB) / 20.0)
    by_ssim = np.sqrt(GRAIN_SSIM_SHARE * (1.0 - wanted.ssim) / max(1.0 - rough.ssim, 1e-12))
    factor = float(min(1.0, by_psnr, by_ssim))
    spent = Fidelity(rough.psnr_db - 20.0 * float(np.log10(factor)), 1.0 - factor**2 * (1.0 - rough.ssim))
    return grain.times(factor), spent


def measure(views: ViewSet, model: GaussianModel, at_view: AtView | None = None) -> Fidelity:
    """Worst view of another model, whatever of it differs, against the images of these views."""
    pairs = [
        (image, render(model if at_view is None else at_view(model, k), camera))
        for k, (image, camera) in enumerate(zip(views.images, views.cameras, strict=True))
    ]
    return Fidelity(min(psnr(a, b) for a, b in pairs), min(ssim(a, b) for a, b in pairs))
