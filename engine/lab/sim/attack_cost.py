"""What an attack costs: how far the attacked model or picture looks from the marked one.

A mark that is gone with the look is not removed but ruined. So every attack is judged by its renders against those of
the marked model, at neutral views: neither the owner's key views nor any an attack was tuned on. A model that the
attack moved is moved back first; of one that it cut, the pixels it still covers are judged apart.
"""

from dataclasses import dataclass

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.model import Bool, Camera, Float32, GaussianModel

CHEAP_DB = 27.0
"""An attack is cheap from this PSNR on: an error of 27 dB against the marked model takes 3 dB off a model that stands
at 27 dB against photographs, as good captures do; the two errors have the same size."""

COVERED = 0.9  # share of the marked model's opacity in a pixel that the attacked one must reach to cover it


@dataclass(frozen=True)
class Cost:
    """Fidelity of the attacked model's renders to the marked model's."""

    psnr: float  # dB, squared errors of all views pooled; infinity where nothing changed
    worst_psnr: float  # of the worst view
    ssim: float  # mean over the views
    coverage: float  # share of the pixels showing the marked model that the attacked one still covers, 0..1
    covered_psnr: float | None  # dB over those pixels alone; None where there are none


def model_cost(
    marked: GaussianModel, attacked: GaussianModel, *, views: int = 4, size: int = 400, seed: int = 0
) -> Cost:
    """Cost of an attack on a model, in so many neutral views around the marked one of `size` (at least 11) pixels a
    side.

    The attacked one may be moved, scaled, turned, cut or re-ordered; it is registered to the marked one, and judged
    where it lies if nothing of it is recognised. `seed` is that of the views and of the registration. InputError if
    there is no view or a model is empty.
    """
    from engine.registration.registration_search import register

    if views < 1 or not len(marked) or not len(attacked):
        raise InputError(f"a cost needs views and Gaussians: {views} views, {len(marked)}, {len(attacked)} Gaussians")
    registration = register(marked, attacked, seed=seed)
    if registration.found:
        attacked = registration.place(attacked)
    jitter = np.random.default_rng((seed, 0xC057)).random((views, 4))
    rig = make_rig(marked, views, size, size, jitter=jitter)
    return _measure([(_picture(marked, camera), _picture(attacked, camera)) for camera in rig])


def image_cost(clean: Float32, attacked: Float32) -> Cost:
    """Cost of an attack on a picture (H, W, 3) that kept its size; InputError where it did not."""
    everywhere = np.ones(clean.shape[:2], dtype=np.float32)
    return _measure([((clean, everywhere), (attacked, everywhere))])


def _picture(model: GaussianModel, camera: Camera) -> tuple[Float32, Float32]:
    """Clipped render (H, W, 3) and opacity (H, W)."""
    from engine.raster import prepare_view, sh_colors

    colors = sh_colors(model.sh, model.means, camera.position.astype(np.float32))
    image, alpha = prepare_view(model, camera).render(colors)
    return np.clip(image, 0.0, 1.0), alpha.reshape(alpha.shape[:2])


def _measure(pairs: list[tuple[tuple[Float32, Float32], tuple[Float32, Float32]]]) -> Cost:
    from engine.numerics.image_metrics import psnr, ssim

    each = [psnr(a, b) for (a, _), (b, _) in pairs]
    pooled = float(np.mean([10.0 ** (-value / 10.0) for value in each]))
    shown = covered = 0
    error = 0.0
    for (a, alpha_a), (b, alpha_b) in pairs:
        visible: Bool = alpha_a > 0.5
        still = visible & (alpha_b >= COVERED * alpha_a)
        shown, covered = shown + int(visible.sum()), covered + int(still.sum())
        error += float(np.square(a[still] - b[still], dtype=np.float64).sum()) / 3.0
    return Cost(
        _decibel(pooled),
        min(each),
        float(np.mean([ssim(a, b) for (a, _), (b, _) in pairs])),
        covered / max(shown, 1),
        _decibel(error / covered) if covered else None,
    )


def _decibel(mse: float) -> float:
    return float("inf") if mse <= 0.0 else float(-10.0 * np.log10(mse))
