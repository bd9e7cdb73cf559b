"""What brightness a picture should have, from its reference: any tone curve and uneven light, by medians.

Coarser than `tone_curve`, but hardly a caption or a painted corner moves it: it decides what counts as evidence.
"""

import numpy as np

from engine.model import Bool, Float32
from engine.pictures.light_field import STILL_UNEVEN, UNEVEN, fit_light

__all__ = ["predict_brightness"]

_BINS = 32
_SAMPLES = 60_000
_ROUNDS = 3


def predict_brightness(reference: Float32, picture: Float32, inside: Bool) -> Float32:
    """Brightness of a picture in register with its reference.

    Parameters
    ----------
    reference, picture : (H, W) float32
        0..1.
    inside : (H, W) bool
        Pixels that the picture shows.

    Returns
    -------
    (H, W) float32
    """
    lit = reference
    predicted = _through_curve(lit, picture, inside)
    for number in range(_ROUNDS):
        light = fit_light(predicted, picture, inside, STILL_UNEVEN if number else UNEVEN)
        if light is None:
            break
        lit = lit * light
        predicted = _through_curve(lit, picture, inside)
    return predicted


def _through_curve(lit: Float32, picture: Float32, inside: Bool) -> Float32:
    """Medians of the picture over bins of equally many pixels, joined by lines, never falling."""
    where = np.flatnonzero(inside)
    where = where[:: max(1, len(where) // _SAMPLES)]
    if len(where) < _BINS:
        return lit
    x, y = lit.ravel()[where], picture.ravel()[where]
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, _BINS)
    centers = np.array([np.median(x[part]) for part in parts])
    heights = np.maximum.accumulate([np.median(y[part]) for part in parts])
    # Beyond the outermost bins the line through the last two goes on.
    low, high = centers[0] - 1.0, centers[-1] + 1.0
    slopes = np.diff(heights)[[0, -1]] / np.maximum(np.diff(centers)[[0, -1]], 1e-3)
    centers = np.concatenate([[low], centers, [high]])
    heights = np.concatenate([[heights[0] - slopes[0]], heights, [heights[-1] + slopes[1]]])
    keep = np.concatenate([[True], np.diff(centers) > 1e-6])
    curve = np.interp(lit, centers[keep], heights[keep])
    return np.asarray(np.clip(curve, 0.0, 1.0), dtype=np.float32)
