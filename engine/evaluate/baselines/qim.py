"""Dithered quantisation index modulation on DC colour: the class of the strongest published CPU method.

Each DC value is moved to the nearest point of one of two interleaved lattices; which one says the bit. Bit and dither
of a Gaussian hang on its quantised position, so that the order of the file is free. Blind: no original is compared.

Sources: Chen and Wornell, "Quantization index modulation", IEEE Trans. Inf. Theory 47(4), 2001; FlyMark (2026) puts it
on DC colours of 3DGS.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.evaluate.baselines.kept import Kept
from engine.evaluate.baselines.strength import at_psnr
from engine.model import Camera, Float32, Float64, GaussianModel, Int64
from engine.pipeline.rigs import measure_extent
from engine.watermark.keys import OwnerKey, uniform
from engine.watermark.messages import Signs

__all__ = ["DitheredQim"]

TABLE = 1 << 16
"""Keyed entries (bit, three dithers) that cells are hashed to."""
CELLS_A_RADIUS = 32
"""Fine enough for thousands of cells, coarse enough that position noise of 0.01 radii leaves a third of the votes."""
PRIMES = (73856093, 19349663, 83492791)
"""Of the spatial hash of Teschner et al., VMV 2003."""
START = 0.1
"""First guess of the step, DC units."""


@dataclass(frozen=True)
class DitheredQim:
    """Two lattices of DC colour; the votes of all Gaussians of a bit are summed softly."""

    name: str = "QIM on DC colour"
    blind: bool = True
    keyed: bool = True
    stands_for: str = (
        "the class of FlyMark (2026): dithered QIM on DC colour, keyed by quantised position. Its own choice of "
        "carriers is not public; all Gaussians carry here, and votes are soft"
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
        """See `Method`; the strength is the lattices' step, DC units."""
        bit, dither = _carriers(model, model, key, len(message))
        dc = model.sh[:, 0].astype(np.float64)
        shift = dither + 0.25 * message[bit].astype(np.float64)[:, None]  # (N, 3); half a step between the two

        def colors_at(step: float) -> Float32:
            sh = model.sh.copy()
            sh[:, 0] = step * (np.round(dc / step - shift) + shift)
            return sh

        marked, step = at_psnr(model, cameras, psnr_db, colors_at, START)
        return marked, Kept(key, len(message), step, model)

    def read_model(self, suspect: GaussianModel, kept: Kept) -> Float64:
        """See `Method`: sines of the phases within the step, +1 on one lattice and -1 on the other."""
        bit, dither = _carriers(suspect, kept.original, kept.key, kept.bits)
        phase = 2.0 * np.pi * (suspect.sh[:, 0].astype(np.float64) / kept.strength - dither)  # (n, 3)
        votes = np.sin(phase).sum(axis=1)
        count = np.bincount(bit, minlength=kept.bits)
        # A vote under a wrong key has variance 3/2.
        return np.bincount(bit, votes, kept.bits) / np.sqrt(1.5 * np.maximum(count, 1))

    def read_picture(self, picture: Float32, kept: Kept) -> None:
        """A reader of models sees no pictures."""


def _carriers(
    model: GaussianModel, frame: GaussianModel, key: OwnerKey, bits: int
) -> tuple[Int64, npt.NDArray[np.float64]]:
    """(n,) bit and (n, 3) dither in steps of each Gaussian, by the cell of the frame that it lies in."""
    extent = measure_extent(frame)
    place = (model.means.astype(np.float64) - extent.center) * (CELLS_A_RADIUS / extent.radius)
    cell = np.floor(np.clip(place, -1e9, 1e9)).astype(np.int64)  # (n, 3)
    entry = np.bitwise_xor.reduce(cell * np.array(PRIMES, dtype=np.int64), axis=1) % TABLE
    table = uniform(key.derive("baseline qim", b""), 4 * TABLE).reshape(TABLE, 4)
    return (table[entry, 0] * bits).astype(np.int64), table[entry, 1:]
