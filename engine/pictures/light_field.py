"""Uneven light in a picture: vignettes, rolling exposure, flicker - a smooth gain over the picture, fitted robustly.

picture(x, y) = gain(x, y) reference(x, y), the gain made of few smooth functions: polynomials over the picture and
waves down its rows. They are a few dozen numbers beside thousands of chips, and depend on no chip.
"""

from functools import lru_cache

import numpy as np

from engine.model import Bool, Float32
from engine.pictures.tone_curve import robust_regression

__all__ = ["STILL_UNEVEN", "UNEVEN", "fit_light"]

UNEVEN, STILL_UNEVEN = 0.08, 0.02
"""Light is uneven when its gain takes this share off the residual's median; once it is, less is worth another round."""
LIMITS = 0.2, 5.0
"""Of the gain."""
_DEGREE = 4
_WAVES = 20
"""Half waves down the rows: ten bands of flicker."""
_SAMPLES = 10_000
_CLIPPED, _BLACK = 0.985, 0.02
_ORDERS = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i) if i + j > 0]
"""Polynomials down and across, of total degree 1 to _DEGREE."""


def fit_light(predicted: Float32, picture: Float32, mask: Bool, least_explained: float = UNEVEN) -> Float32 | None:
    """Smooth gain of a picture over what was predicted.

    Parameters
    ----------
    predicted : (H, W) float32
        Brightness of the reference, toned like the picture, 0..1.
    picture : (H, W) float32
        Brightness of the picture in the same pixels, 0..1.
    mask : (H, W) bool
        Pixels to fit on.
    least_explained : float
        Share of the residual's median that the gain must take off, 0..1.

    Returns
    -------
    (H, W) float32 or None
        None where the light is even, or too little is seen to tell.
    """
    height, width = predicted.shape
    where = np.flatnonzero(mask & (picture < _CLIPPED) & (predicted > _BLACK))
    where = where[:: max(1, len(where) // _SAMPLES)]
    across, down, waves = _functions(height, width)
    rows, columns = np.divmod(where, width)
    polynomials = [down[rows, i] * across[columns, j] for i, j in _ORDERS]
    functions = np.concatenate([np.stack(polynomials, axis=1), waves[rows]], axis=1)  # (P, F)
    count = functions.shape[1]
    if len(where) < 20 * count:
        return None
    expected = predicted.ravel()[where]
    missing = picture.ravel()[where] - expected
    # What the tone curve took for itself comes back: else the two chase each other through many rounds.
    tones = np.stack([np.ones_like(expected), expected, expected**2, expected**3], axis=1)
    design = np.concatenate([functions * expected[:, None], tones], axis=1)
    solution = robust_regression(design, missing).astype(np.float32)
    left = missing - design @ solution
    if np.median(np.abs(left)) > (1.0 - least_explained) * np.median(np.abs(missing)):
        return None
    weights = np.zeros((_DEGREE + 1, _DEGREE + 1), dtype=np.float32)
    for (i, j), value in zip(_ORDERS, solution, strict=False):
        weights[i, j] = value
    uneven = down @ weights @ across.T + (waves @ solution[len(_ORDERS) : count])[:, None]
    # Over a small object the functions may add up to a constant, which belongs to the tone: it would run away.
    uneven -= np.average(uneven.ravel()[where], weights=expected)
    return np.clip(1.0 + uneven, *LIMITS).astype(np.float32)


@lru_cache(maxsize=8)
def _functions(height: int, width: int) -> tuple[Float32, Float32, Float32]:
    """Legendre polynomials across (W, D + 1) and down (H, D + 1), and cosines down (H, waves)."""
    x, y = ((2.0 * np.arange(n) + 1.0) / n - 1.0 for n in (width, height))
    across, down = (np.polynomial.legendre.legvander(axis, _DEGREE) for axis in (x, y))
    waves = np.cos(0.5 * np.pi * (y[:, None] + 1.0) * np.arange(1, _WAVES + 1))
    return across.astype(np.float32), down.astype(np.float32), waves.astype(np.float32)
