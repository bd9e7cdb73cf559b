"""Uneven light in a picture: vignettes, rolling exposure, flicker - a smooth gain over it, fitted robustly and by turns
with its tone, which is what happened to the colours of a picture and where.

picture(x, y) = gain(x, y) reference(x, y), the gain made of few smooth functions: polynomials over the picture and
waves down its rows. They are a few dozen numbers, against thousands of chips, and depend on no chip.
"""

from functools import lru_cache

import numpy as np

from engine.model import Bool, Float32
from engine.pictures.alignment.config import CONFIG
from engine.pictures.alignment.tone_curve import Toned, fit_tone, robust_regression
from engine.pictures.landmarks.keypoints import LUMA

__all__ = ["fit_colors", "fit_light", "predict_brightness"]

_CONFIG = CONFIG.light
_ORDERS = [(i, j) for i in range(_CONFIG.degree + 1) for j in range(_CONFIG.degree + 1 - i) if i + j > 0]
"""Polynomials down and across, of total degree 1 to `degree`."""


def fit_light(
    predicted: Float32, picture: Float32, mask: Bool, least_explained: float = _CONFIG.uneven
) -> Float32 | None:
    """Smooth gain (H, W) of a picture's brightness over what was predicted: the reference, toned like it; both (H, W),
    0..1.

    None where the light is even (the gain must take the share `least_explained` off the residual's median), or too
    little is seen in `mask` to tell.
    """
    height, width = predicted.shape
    where = np.flatnonzero(mask & (picture < _CONFIG.clipped) & (predicted > _CONFIG.black))
    where = where[:: max(1, len(where) // _CONFIG.samples)]
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
    tones = np.stack([np.ones_like(expected), expected, expected**2, expected**3], axis=1)  # (P, 4)
    design = np.concatenate([functions * expected[:, None], tones], axis=1)  # (P, F + 4)
    solution = robust_regression(design, missing).astype(np.float32)
    left = missing - design @ solution
    if np.median(np.abs(left)) > (1.0 - least_explained) * np.median(np.abs(missing)):
        return None
    weights = np.zeros((_CONFIG.degree + 1, _CONFIG.degree + 1), dtype=np.float32)
    for (i, j), value in zip(_ORDERS, solution, strict=False):
        weights[i, j] = value
    uneven = down @ weights @ across.T + (waves @ solution[len(_ORDERS) : count])[:, None]
    # Over a small object the functions may add up to a constant, which belongs to the tone: it would run away.
    uneven -= np.average(uneven.ravel()[where], weights=expected)
    return np.clip(1.0 + uneven, *_CONFIG.gains).astype(np.float32)


@lru_cache(maxsize=8)
def _functions(height: int, width: int) -> tuple[Float32, Float32, Float32]:
    """Legendre polynomials across (W, D + 1) and down (H, D + 1), and cosines down (H, waves)."""
    x, y = ((2.0 * np.arange(n) + 1.0) / n - 1.0 for n in (width, height))
    across, down = (np.polynomial.legendre.legvander(axis, _CONFIG.degree) for axis in (x, y))
    waves = np.cos(0.5 * np.pi * (y[:, None] + 1.0) * np.arange(1, _CONFIG.waves + 1))
    return across.astype(np.float32), down.astype(np.float32), waves.astype(np.float32)


def fit_colors(reference: Float32, picture: Float32, mask: Bool) -> Toned:
    """Tone and uneven light by turns, each on what the other leaves; even light costs no second round.

    `reference` and `picture` (H, W, 3), 0..1, in register; `mask` (H, W), pixels to fit on. The slope returned is that
    of the tone times the gain of the light.
    """
    toned = fit_tone(reference, picture, mask, _CONFIG.tone_knots)
    gain = np.ones(mask.shape, dtype=np.float32)
    for number in range(_CONFIG.color_rounds):
        least = _CONFIG.still_uneven if number else _CONFIG.uneven
        light = fit_light(toned.predicted @ LUMA, picture @ LUMA, mask, least)
        if light is None:
            break
        gain = gain * light
        toned = fit_tone(reference * gain[..., None], picture, mask, _CONFIG.tone_knots)
    return Toned(toned.predicted, toned.slope * gain[..., None])


def predict_brightness(reference: Float32, picture: Float32, inside: Bool) -> Float32:
    """(H, W) brightness of a picture in register with its reference, both (H, W) and 0..1, from the pixels `inside`
    that it shows: any tone curve and uneven light, by medians.

    Coarser than `fit_colors`, but hardly a caption or a painted corner moves it: it decides what counts as evidence.
    """
    lit = reference
    predicted = _through_curve(lit, picture, inside)
    for number in range(_CONFIG.curve_rounds):
        light = fit_light(predicted, picture, inside, _CONFIG.still_uneven if number else _CONFIG.uneven)
        if light is None:
            break
        lit = lit * light
        predicted = _through_curve(lit, picture, inside)
    return predicted


def _through_curve(lit: Float32, picture: Float32, inside: Bool) -> Float32:
    """Medians of the picture over bins of equally many pixels, joined by lines, never falling."""
    where = np.flatnonzero(inside)
    where = where[:: max(1, len(where) // _CONFIG.curve_samples)]
    if len(where) < _CONFIG.curve_bins:
        return lit
    x, y = lit.ravel()[where], picture.ravel()[where]
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, _CONFIG.curve_bins)
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
