"""What a way to mark models is: the small interface that compares others with ours, at one fidelity for all."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from engine.flows.views.view_set import look
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.watermark.keys import OwnerKey
from engine.watermark.messages import Signs

__all__ = ["Kept", "Method"]

ROUNDS = 12
CLOSE_DB = 0.05
"""How far above its target the worst view may end."""


@dataclass(frozen=True, eq=False)
class Kept:
    """What the owner keeps of a marking: all that reading may use; each method takes what its class needs."""

    key: OwnerKey  # replace it to see what a wrong key reads
    bits: int  # of the message
    strength: float  # at which it was marked, in the method's own unit
    original: GaussianModel  # blind methods take no attribute of a Gaussian from it, only the frame of the scene


@dataclass(frozen=True)
class Method(ABC):
    """A way to mark models. Everything is a function of its arguments: the same input gives the same bytes."""

    name: str  # in tables
    stands_for: str  # which published class this is, and what of it is not
    informed: bool = False  # whether reading compares with the original

    @abstractmethod
    def colors(self, model: GaussianModel, key: OwnerKey, message: Signs) -> tuple[Callable[[float], Float32], float]:
        """Strength -> marked SH (N, K, 3), whose error grows about linearly with it; and a first guess, > 0."""

    def embed(
        self, model: GaussianModel, key: OwnerKey, message: Signs, psnr_db: float, cameras: Sequence[Camera]
    ) -> tuple[GaussianModel, Kept]:
        """The model, marked as strongly as a PSNR in the worst of some views allows, and what reading needs."""
        colors_at, start = self.colors(model, key, message)
        sh, strength = _at_psnr(model, cameras, psnr_db, colors_at, start)
        return model.with_(sh=sh), Kept(key, len(message), strength, model)

    def read_model(self, suspect: GaussianModel, kept: Kept) -> Float64 | None:
        """(B,) scores whose signs are the bits; None for a method that reads no models."""
        return None

    def read_picture(self, picture: Float32, kept: Kept) -> Float64 | None:
        """(B,) scores from one picture (H, W, 3) in 0..1; None for a method that reads no pictures."""
        return None


def _at_psnr(
    model: GaussianModel, cameras: Sequence[Camera], psnr_db: float, colors_at: Callable[[float], Float32], start: float
) -> tuple[Float32, float]:
    """The strongest colours whose worst view lies within 0.05 dB above a PSNR against the unmarked render.

    Those at the first guess, where nothing in sight changes at any strength.
    """
    views = look(model, cameras, lambda _: None)
    strength, low, high = start, 0.0, np.inf
    best, best_strength = model.sh, 0.0
    for _ in range(ROUNDS):
        sh = colors_at(strength)
        found = views.worst(sh)
        if not np.isfinite(found):
            return sh, strength
        if found >= psnr_db:
            low, best, best_strength = strength, sh, strength
            if found <= psnr_db + CLOSE_DB:
                break
        else:
            high = strength
        # 20 dB a decade; kept inside what is known, should the error not be quite linear.
        aimed = strength * 10.0 ** ((found - psnr_db - 0.5 * CLOSE_DB) / 20.0)
        strength = aimed if low < aimed < high else 0.5 * (low + high)
    return best, best_strength
