"""Gaussians that hold still: moving a value that very many share would be visible without the key.

Files of few values clip: on real scenes up to half of all Gaussians have a channel at pure white or black. A mark that
moved them would tear such a mass apart, and a histogram shows that. They get a code vector of their own that carries
nothing; the others then carry a little more for the same PSNR.
"""

import numpy as np
import numpy.typing as npt

from engine.compress.hvq import Stage
from engine.model import Float32, Float64

MOST = 2.0 / 3.0
"""Share of the Gaussians that may hold still. More means that the scene has few values, not that some were clipped."""
GRID = 512.0
"""Values are compared in steps of 1/512, as the reference keeps them."""


def spare_masses(
    dc: Float32, stages: tuple[Stage, ...], share: float, emphasis: Float32 | Float64 | None = None
) -> tuple[tuple[Stage, ...], Float32 | Float64 | None]:
    """Quantiser and emphasis (N,) under which the masses of a DC (N, 3), see `find_masses`, hold still.

    Where there are masses, the first stage has one more code and the emphasis, see `make_plan`, is 0 on them.
    """
    still = find_masses(dc, share)
    if not still.any():
        return stages, emphasis
    return (set_aside(stages[0], still), *stages[1:]), np.where(still, 0.0, 1.0 if emphasis is None else emphasis)


def find_masses(dc: Float32, share: float) -> npt.NDArray[np.bool_]:
    """(N,) Gaussians with a DC value, in any channel, that more than this share of all have; none where most would."""
    still = np.zeros(len(dc), dtype=bool)
    for channel in np.round(GRID * dc.astype(np.float64)).astype(np.int64).T:
        _, place, count = np.unique(channel, return_inverse=True, return_counts=True)
        still |= (count > share * len(dc))[place]
    return still if still.mean() <= MOST else np.zeros_like(still)


def set_aside(stage: Stage, still: npt.NDArray[np.bool_]) -> Stage:
    """The stage with one more code, the last, which all that hold still have."""
    count = len(stage.codebook)
    labels = np.where(still, np.int32(count), stage.labels).astype(np.int32)
    mean = (stage.codebook[stage.labels[still]]).mean(axis=0, keepdims=True)
    return Stage(np.concatenate([stage.codebook, mean]), labels)
