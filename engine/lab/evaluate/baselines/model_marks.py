"""Marks put into the colours of a model at once: quantisation index modulation, and additive spread spectrum.

QIM: each DC value is moved to the nearest point of one of two interleaved lattices; which one says the bit. Bit and
dither of a Gaussian hang on its quantised position, so that the order of the file is free. Blind: no original is
compared. Chen and Wornell, "Quantization index modulation", IEEE Trans. Inf. Theory 47(4), 2001; FlyMark (2026), the
strongest published CPU method, puts it on DC colours of 3DGS.

Spread spectrum: keyed signs on the DCT of the DC colours in the order of the file. Informed: the original is
subtracted. Cox, Kilian, Leighton, Shamoon, "Secure spread spectrum watermarking for multimedia", IEEE TIP 6(12), 1997;
Deng, Nakra and Wu's position paper (2026) does so to 3DGS, with keys from an HMAC.
"""

from collections.abc import Callable

import numpy as np
from scipy.fft import dct, idct

from engine.flows.views.camera_rig import measure_extent
from engine.lab.evaluate.baselines.method import Kept, Method
from engine.model import Float32, Float64, GaussianModel, Int64
from engine.watermark.keys import OwnerKey, signs, uniform
from engine.watermark.messages import Signs

__all__ = ["DitheredQim", "FileOrderSpreadSpectrum", "bit_scores"]

TABLE = 1 << 16
"""Keyed entries (bit, three dithers) that cells are hashed to."""
CELLS_A_RADIUS = 32
"""Fine enough for thousands of cells, coarse enough that position noise of 0.01 radii leaves a third of the votes."""
PRIMES = (73856093, 19349663, 83492791)
"""Of the spatial hash of Teschner et al., VMV 2003."""
STEP = 0.1
"""First guess of the lattices' step, DC units."""
BAND = (0.05, 0.6)
"""Part of the spectrum that carries, of the highest frequency."""
AMPLITUDE = 0.02
"""First guess of the amplitude of a coefficient, DC units."""


class DitheredQim(Method):
    """Two lattices of DC colour; the votes of all Gaussians of a bit are summed softly."""

    def colors(self, model: GaussianModel, key: OwnerKey, message: Signs) -> tuple[Callable[[float], Float32], float]:
        """See `Method`; the strength is the lattices' step, DC units."""
        bit, dither = _carriers(model, model, key, len(message))
        dc = model.sh[:, 0].astype(np.float64)
        shift = dither + 0.25 * message[bit].astype(np.float64)[:, None]  # (N, 3); half a step between the two

        def colors_at(step: float) -> Float32:
            sh = model.sh.copy()
            sh[:, 0] = step * (np.round(dc / step - shift) + shift)
            return sh

        return colors_at, STEP

    def read_model(self, suspect: GaussianModel, kept: Kept) -> Float64:
        """See `Method`: sines of the phases within the step, +1 on one lattice and -1 on the other."""
        bit, dither = _carriers(suspect, kept.original, kept.key, kept.bits)
        phase = 2.0 * np.pi * (suspect.sh[:, 0].astype(np.float64) / kept.strength - dither)  # (n, 3)
        votes = np.sin(phase).sum(axis=1)
        count = np.bincount(bit, minlength=kept.bits)
        # A vote under a wrong key has variance 3/2.
        return np.bincount(bit, votes, kept.bits) / np.sqrt(1.5 * np.maximum(count, 1))


def _carriers(model: GaussianModel, frame: GaussianModel, key: OwnerKey, bits: int) -> tuple[Int64, Float64]:
    """(n,) bit and (n, 3) dither in steps of each Gaussian, by the cell of the frame that it lies in."""
    extent = measure_extent(frame)
    place = (model.means.astype(np.float64) - extent.center) * (CELLS_A_RADIUS / extent.radius)
    cell = np.floor(np.clip(place, -1e9, 1e9)).astype(np.int64)  # (n, 3)
    entry = np.bitwise_xor.reduce(cell * np.array(PRIMES, dtype=np.int64), axis=1) % TABLE
    table = uniform(key.derive("baseline qim", b""), 4 * TABLE).reshape(TABLE, 4)
    return (table[entry, 0] * bits).astype(np.int64), table[entry, 1:]


class FileOrderSpreadSpectrum(Method):
    """Each bit is the sign of a keyed pattern over its share of the DCT coefficients."""

    def colors(self, model: GaussianModel, key: OwnerKey, message: Signs) -> tuple[Callable[[float], Float32], float]:
        """See `Method`; the strength is the amplitude of a coefficient, DC units."""
        pattern = _pattern(len(model), key)  # (N, 3)
        sign = message[np.arange(len(model)) % len(message)].astype(np.float64)[:, None]
        displacement = idct(pattern * sign, axis=0, norm="ortho").astype(np.float32)

        def colors_at(strength: float) -> Float32:
            sh = model.sh.copy()
            sh[:, 0] += np.float32(strength) * displacement
            return sh

        return colors_at, AMPLITUDE

    def read_model(self, suspect: GaussianModel, kept: Kept) -> Float64:
        """See `Method`. Rows are compared by their number; where the suspect has fewer, nothing is said to differ."""
        count = len(kept.original)
        shared = min(count, len(suspect))
        difference = np.zeros((count, 3))
        difference[:shared] = suspect.sh[:shared, 0].astype(np.float64) - kept.original.sh[:shared, 0]
        y = _pattern(count, kept.key) * dct(difference, axis=0, norm="ortho")
        return bit_scores(np.arange(count) % kept.bits, y.sum(axis=1), (y**2).sum(axis=1), kept.bits)


def _pattern(count: int, key: OwnerKey) -> Float64:
    """(count, 3) keyed signs on the coefficients of the band, 0 elsewhere."""
    pattern = signs(key.derive("baseline spread", b""), 3 * count).reshape(count, 3).astype(np.float64)
    low, high = (round(part * count) for part in BAND)
    pattern[:low] = pattern[high:] = 0.0
    return pattern


def bit_scores(bit: Int64, votes: Float64, powers: Float64, bits: int) -> Float64:
    """(bits,) votes summed by the bit that each belongs to, over the root of their summed powers."""
    return np.bincount(bit, votes, bits) / np.sqrt(np.maximum(np.bincount(bit, powers, bits), 1e-300))
