"""Box queries by looking at every box: what the bounding-volume hierarchy must answer."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt


def overlapping(
    lows: npt.NDArray[np.float64],
    highs: npt.NDArray[np.float64],
    low: npt.NDArray[np.float64],
    high: npt.NDArray[np.float64],
) -> list[int]:
    """Boxes that touch low..high, ascending."""
    return [i for i in range(len(lows)) if all(lows[i][a] <= high[a] and highs[i][a] >= low[a] for a in range(3))]


def along_ray(
    lows: npt.NDArray[np.float64],
    highs: npt.NDArray[np.float64],
    origin: npt.NDArray[np.float64],
    direction: npt.NDArray[np.float64],
) -> dict[int, float]:
    """Boxes that a ray meets, and where it enters: the slab test, one axis after the other."""
    unit = direction / math.sqrt(sum(v * v for v in direction))
    found = {}
    for i in range(len(lows)):
        near, far = 0.0, math.inf
        for a in range(3):
            if unit[a] == 0:
                if not lows[i][a] <= origin[a] <= highs[i][a]:
                    far = -1.0
                continue
            ends = sorted(((lows[i][a] - origin[a]) / unit[a], (highs[i][a] - origin[a]) / unit[a]))
            near, far = max(near, ends[0]), min(far, ends[1])
        if near <= far:
            found[i] = near
    return found
