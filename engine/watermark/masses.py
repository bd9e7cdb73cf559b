"""Gaussians that hold still: moving a value that very many share would be visible without the key.

Files of few values clip: on real scenes up to half of all Gaussians have a channel at pure white or black. A mark that
moved them would tear such a mass apart, and a histogram shows that. The others then carry a little more for the same
PSNR.
"""

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from engine.model import Float32
from engine.watermark.config import CONFIG

GRID = 512.0
"""Values are compared in steps of 1/512, as the reference keeps them."""
AROUND = 3
"""Values on either side that say how many Gaussians have a usual one."""


def find_masses(dc: Float32, share: float) -> npt.NDArray[np.bool_]:
    """(N,) Gaussians with a DC value, in any channel, that more than this share of all have, and far more than have the
    values around it; none where most would. What many have because values are few is moved: held, it would show."""
    still = np.zeros(len(dc), dtype=bool)
    for channel in np.round(GRID * dc.astype(np.float64)).astype(np.int64).T:
        _, place, count = np.unique(channel, return_inverse=True, return_counts=True)
        around = sliding_window_view(np.pad(count, AROUND, mode="reflect"), 2 * AROUND + 1)
        usual = np.median(around, axis=-1)
        still |= ((count > share * len(dc)) & (count > CONFIG.planning.mass_factor * usual))[place]
    return still if still.mean() <= CONFIG.planning.most_still else np.zeros_like(still)
