"""Additive spread spectrum over the file index: keyed signs on the DCT of the DC colours in the order of the file.

Sources: Cox, Kilian, Leighton, Shamoon, "Secure spread spectrum watermarking for multimedia", IEEE TIP 6(12), 1997;
Deng, Nakra and Wu's position paper (2026) does so to 3DGS, with keys from an HMAC. Informed: the original is
subtracted.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct

from engine.evaluate.baselines.kept import Kept
from engine.evaluate.baselines.strength import at_psnr
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.watermark.keys import OwnerKey, signs
from engine.watermark.messages import Signs

__all__ = ["FileOrderSpreadSpectrum"]

BAND = (0.05, 0.6)
"""Part of the spectrum that carries, of the highest frequency."""
START = 0.02
"""First guess of the amplitude of a coefficient, DC units."""


@dataclass(frozen=True)
class FileOrderSpreadSpectrum:
    """Each bit is the sign of a keyed pattern over its share of the DCT coefficients."""

    name: str = "spread spectrum over the file index"
    blind: bool = False
    keyed: bool = True
    stands_for: str = (
        "the position paper of Deng, Nakra and Wu (2026): DCT along the file's order, keyed signs, read by "
        "subtracting the original. Additive, where the paper's is multiplicative"
    )

    def missing(self) -> str:
        """Runs everywhere."""
        return ""

    def cameras(self, original: GaussianModel) -> list[Camera]:
        """A reader of models needs no views."""
        return []

    def embed(
        self, model: GaussianModel, key: OwnerKey, message: Signs, psnr_db: float, cameras: Sequence[Camera]
    ) -> tuple[GaussianModel, Kept]:
        """See `Method`; the strength is the amplitude of a coefficient, DC units."""
        pattern = _pattern(len(model), key)  # (N, 3)
        sign = message[np.arange(len(model)) % len(message)].astype(np.float64)[:, None]
        displacement = idct(pattern * sign, axis=0, norm="ortho").astype(np.float32)

        def colors_at(strength: float) -> Float32:
            sh = model.sh.copy()
            sh[:, 0] += np.float32(strength) * displacement
            return sh

        marked, strength = at_psnr(model, cameras, psnr_db, colors_at, START)
        return marked, Kept(key, len(message), strength, model)

    def read_model(self, suspect: GaussianModel, kept: Kept) -> Float64:
        """See `Method`. Rows are compared by their number; where the suspect has fewer, nothing is said to differ."""
        count = len(kept.original)
        shared = min(count, len(suspect))
        difference = np.zeros((count, 3))
        difference[:shared] = suspect.sh[:shared, 0].astype(np.float64) - kept.original.sh[:shared, 0]
        y = _pattern(count, kept.key) * dct(difference, axis=0, norm="ortho")
        bit = np.arange(count) % kept.bits
        sums = np.bincount(bit, y.sum(axis=1), kept.bits)
        powers = np.bincount(bit, (y**2).sum(axis=1), kept.bits)
        return sums / np.sqrt(np.maximum(powers, 1e-300))

    def read_picture(self, picture: Float32, kept: Kept) -> None:
        """A reader of models sees no pictures."""


def _pattern(count: int, key: OwnerKey) -> Float64:
    """(count, 3) keyed signs on the coefficients of the band, 0 elsewhere."""
    pattern = signs(key.derive("baseline spread", b""), 3 * count).reshape(count, 3).astype(np.float64)
    low, high = (round(part * count) for part in BAND)
    pattern[:low] = pattern[high:] = 0.0
    return pattern
