"""One fidelity for all methods: the strength at which the worst of the same views has the same PSNR."""

from collections.abc import Callable, Sequence

import numpy as np

from engine.model import Camera, Float32, GaussianModel
from engine.pipeline.scenes import look

__all__ = ["at_psnr"]

ROUNDS = 12
CLOSE_DB = 0.05
"""How far above its target the worst view may end."""


def at_psnr(
    model: GaussianModel, cameras: Sequence[Camera], psnr_db: float, colors_at: Callable[[float], Float32], start: float
) -> tuple[GaussianModel, float]:
    """The model with the strongest colours that keep a PSNR in the worst view.

    Parameters
    ----------
    model : GaussianModel
        Unmarked.
    cameras : sequence of Camera
    psnr_db : float
        Against the unmarked render.
    colors_at : callable
        Strength -> marked SH (N, K, 3); the error grows about linearly with the strength.
    start : float
        First guess of the strength, > 0.

    Returns
    -------
    model : GaussianModel
        Its worst view lies within 0.05 dB above the target; unless nothing in sight changes at any strength.
    strength : float
    """
    views = look(model, cameras, lambda _: None)
    strength, low, high = start, 0.0, np.inf
    best, best_strength = model.sh, 0.0
    for _ in range(ROUNDS):
        sh = colors_at(strength)
        found = views.worst(sh)
        if not np.isfinite(found):
            return model.with_(sh=sh), strength
        if found >= psnr_db:
            low, best, best_strength = strength, sh, strength
            if found <= psnr_db + CLOSE_DB:
                break
        else:
            high = strength
        # 20 dB a decade; kept inside what is known, should the error not be quite linear.
        aimed = strength * 10.0 ** ((found - psnr_db - 0.5 * CLOSE_DB) / 20.0)
        inside = low < aimed < high
        strength = aimed if inside else 0.5 * (low + high)
    return model.with_(sh=best), best_strength
