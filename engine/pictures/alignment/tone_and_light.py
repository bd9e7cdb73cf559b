"""What happened to the colors of a picture: exposure, tint, tone curve, clipping, uneven light - fitted robustly.

A picture of the reference shows not x but f(x). The mark shows as f'(x) times itself: nothing where the
picture is clipped, half of it where noise pushes half of the values against the limit.

Light is uneven by vignettes, rolling exposure and flicker: picture(x, y) = gain(x, y) reference(x, y), the gain made of
few smooth functions: polynomials over the picture and waves down its rows. They are a few dozen numbers, against
thousands of chips, and depend on no chip. Gain and tone are fitted by turns.

Viewers such as PlayCanvas, and so SuperSplat, apply a curve to every Gaussian before blending. A curve of blended
colors is another picture: half of a bright Gaussian over a dark one is not what half of their curves is. Where such a
viewer made a picture, the reference is drawn with the same curve, found by which render explains the picture; what is
left is fitted as for any picture. Nothing here sees a key or a chip.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from engine.model import Bool, Camera, Float32, Float64, GaussianModel
from engine.numerics.resampling import resized
from engine.numerics.tables import look_up
from engine.pictures.alignment.config import CONFIG
from engine.pictures.landmarks.keypoints import LUMA, noise_level
from engine.raster import RasterSettings, Rendering, draw

_CONFIG, _LIGHT, _VIEWER = CONFIG.tone, CONFIG.light, CONFIG.viewer_tone


@dataclass(frozen=True, eq=False)
class Toned:
    """The reference as the picture would show it: its expected values, and the share of a small change of colour that
    survives clipping, 0..1; (H, W, 3) each."""

    predicted: Float32
    slope: Float32


def robust_regression(design: Float32, target: Float32, rounds: int = 4) -> Float64:
    """Least squares (K,) of a design (P, K) with Cauchy weights on the residual; zeros when there are fewer than 4 K
    rows."""
    k = design.shape[1]
    if len(design) < 4 * k:
        return np.zeros(k)
    weight = np.ones(len(target), dtype=np.float32)
    solution: Float64 = np.zeros(k)
    for _ in range(rounds):
        weighted = design * weight[:, None]
        normal = (weighted.T @ design).astype(np.float64)
        # A column without content (an image without edges) gets a zero, not a singular matrix.
        normal[np.diag_indices(k)] += 1e-6 * np.trace(normal) / k + 1e-12
        solution = np.asarray(np.linalg.solve(normal, weighted.T @ target), dtype=np.float64)
        residual = target - design @ solution.astype(np.float32)
        spread = 1.4826 * float(np.median(np.abs(residual))) + 1e-4
        weight = 1.0 / (1.0 + np.square(residual / (3.0 * spread)))
    return solution


def fit_tone(reference: Float32, picture: Float32, mask: Bool, knots: int) -> Toned:
    """Fit, in this order: affine colour change, clipping with the picture's own noise, tone curve a channel of so many
    knots.

    `reference` and `picture` (H, W, 3), 0..1, in register; `mask` (H, W), pixels to fit on.
    """
    where = np.nonzero(mask.ravel())[0]
    where = where[:: max(1, len(where) // _CONFIG.samples)]
    colors, seen = reference.reshape(-1, 3), picture.reshape(-1, 3)[where]  # (H W, 3), (P, 3)
    design = np.concatenate([colors[where], np.ones((len(where), 1), dtype=np.float32)], axis=1)  # (P, 4)
    free = (seen < _CONFIG.clipped).all(axis=1) & (seen > 1.0 - _CONFIG.clipped).any(axis=1)
    predicted, slope = np.empty_like(reference), np.empty_like(reference)
    for c in range(3):
        affine = robust_regression(design[free], seen[free, c])
        if not affine.any():  # hardly a pixel that is not clipped: take the colours as they are
            affine[c] = 1.0
        linear = (colors @ affine[:3].astype(np.float32) + np.float32(affine[3])).reshape(mask.shape)
        noise = max(noise_level(np.where(mask, picture[..., c] - linear, 0.0)), _CONFIG.least_noise)
        low, high = float(linear.min()) - 1e-6, float(linear.max()) + 1e-6
        grid = np.linspace(low, high, _CONFIG.table)
        value, keep = _clipped_mean(grid, noise)
        level = np.interp(linear.ravel()[where], grid, value)
        curve = _fit_curve(level, seen[:, c], knots)
        turned = np.abs(curve(level) - level)
        if free.any() and float(np.quantile(turned, 0.95, method="lower")) > _CONFIG.bent:
            # An affine fit alone takes a strong curve for a mixture of the channels, and no curve can undo that.
            bent = _fit_bent(design[::2], seen[::2, c], c)
            missed = np.abs(seen[free, c] - curve(level[free]))
            if bent.error < _CONFIG.better * float(np.median(missed)):
                shown = bent(colors.reshape(reference.shape))
                noise = max(noise_level(np.where(mask, picture[..., c] - shown, 0.0)), _CONFIG.least_noise)
                low, high = float(shown.min()) - 1e-6, float(shown.max()) + 1e-6
                grid = np.linspace(low, high, _CONFIG.table)
                predicted[..., c] = shown
                slope[..., c] = look_up(
                    shown, low, high, _normal_below((1.0 - grid) / noise) - _normal_below(-grid / noise)
                )
                continue
        predicted[..., c] = look_up(linear, low, high, curve(value))
        slope[..., c] = look_up(linear, low, high, keep)
    return Toned(predicted, slope)


def _clipped_mean(u: Float64, noise: float) -> tuple[Float64, Float64]:
    """E[clip(u + n, 0, 1)] and its derivative for Gaussian n of standard deviation `noise`."""
    low, high = -u / noise, (1.0 - u) / noise
    inside = _normal_below(high) - _normal_below(low)
    density = (np.exp(-0.5 * high**2) - np.exp(-0.5 * low**2)) / np.sqrt(2.0 * np.pi)
    return u * inside - noise * density + _normal_below(-high), inside


def _normal_below(x: Float64) -> Float64:
    """Share of the standard normal distribution below each value. SciPy's takes a tenth of a second to import."""
    return np.array([0.5 * math.erfc(-value / math.sqrt(2.0)) for value in x.tolist()])


@dataclass(frozen=True, eq=False)
class _Bent:
    """A curve of a mixture of the channels, f(mix . (r, g, b, 1)), dense at the dark end; `error` is its median
    miss."""

    mix: Float64
    low: float
    high: float
    values: Float64  # where the root of the way from low to high takes even steps
    error: float

    def __call__(self, colors: Float32) -> Float32:
        """(H, W) of colours (H, W, 3)."""
        linear = colors @ self.mix[:3].astype(np.float32) + np.float32(self.mix[3])
        way = np.sqrt(np.clip((linear - self.low) / (self.high - self.low), 0.0, 1.0))
        return look_up(way, 0.0, 1.0, self.values)


def _fit_bent(rows: Float32, seen: Float32, channel: int) -> _Bent:
    """Mixture and curve by turns, starting from the channel as it is; rows (P, 4) are colours and a one."""
    free = (seen < _CONFIG.clipped) & (seen > 1.0 - _CONFIG.clipped)
    best: _Bent | None = None
    mix: Float64 = np.eye(4)[channel]
    for _ in range(_CONFIG.bent_rounds):
        x = rows @ mix
        low, high = float(x.min(initial=0.0)) - 1e-6, float(x.max(initial=1.0)) + 1e-6
        # Knots lie dense at the dark end, where gammas are steep.
        curve = _fit_curve(np.sqrt((x - low) / (high - low)), seen, _CONFIG.bent_knots, far=True)
        grid = low + (high - low) * np.linspace(0.0, 1.0, _CONFIG.table) ** 2
        values = curve(np.linspace(0.0, 1.0, _CONFIG.table))
        left = seen - np.interp(x, grid, values)
        error = float(np.median(np.abs(left[free]))) if free.any() else np.inf
        if best is None or error < best.error:
            best = _Bent(mix, low, high, values, error)
        steep = np.interp(x, grid, np.gradient(values, grid))
        columns = (steep[:, None] * rows).astype(np.float32)
        mix = mix + robust_regression(columns[free], left[free].astype(np.float32))
    assert best is not None
    return best


class _Curve:
    """Piecewise linear function on [0, 1]."""

    def __init__(self, heights: Float64) -> None:
        self.heights = heights

    def __call__(self, x: npt.NDArray[np.float64]) -> Float64:
        return np.interp(x, np.linspace(0.0, 1.0, len(self.heights)), self.heights)


def _fit_curve(x: Float64, y: Float32, knots: int, *, far: bool = False) -> _Curve:
    """Tone curve y = f(x) as a correction of the identity that is smooth and zero where nothing is known.

    With `far` the curve may lie far from the identity, and the first round takes no sample for an outlier.
    """
    ridge, rounds = (1e-7, 4) if far else (1e-4, 2)
    x = np.clip(x, 0.0, 1.0)
    cell = np.minimum((x * (knots - 1)).astype(np.int64), knots - 2)
    t = x * (knots - 1) - cell
    correction = np.zeros(knots)
    bend = np.diff(np.eye(knots), 2, axis=0)
    normal = 1e-3 * len(x) / knots * (bend.T @ bend) + (ridge * len(x) + 1e-9) * np.eye(knots)
    diagonal = np.bincount(cell, (1 - t) ** 2, knots) + np.bincount(cell + 1, t * t, knots)
    between = np.bincount(cell, t * (1 - t), knots)[:-1]
    normal += np.diag(diagonal) + np.diag(between, 1) + np.diag(between, -1)
    for number in range(rounds):
        fitted = correction[cell] * (1 - t) + correction[cell + 1] * t
        residual = y - x - fitted
        # A mean, with outliers pulled in: a median would be biased where noise meets the limit.
        # Black pixels carry no information about the spread elsewhere.
        judged = residual[y > 1.0 - _CONFIG.clipped] if far else residual
        limit = 4.0 * (1.4826 * float(np.median(np.abs(judged))) + 1e-3) if len(judged) else 1.0
        if far and number == 0:
            limit = np.inf
        pulled = fitted + np.clip(residual, -limit, limit)
        moment = np.bincount(cell, (1 - t) * pulled, knots) + np.bincount(cell + 1, t * pulled, knots)
        correction = np.linalg.solve(normal, moment)
    return _Curve(np.linspace(0.0, 1.0, knots) + correction)


GAMMA = 2.2
"""By which these viewers decode colors before a curve, and encode them again."""


@dataclass(frozen=True)
class ViewerTone:
    """A curve (N, 3) -> (N, 3) of linear light, by the viewer's name of it."""

    name: str
    of_light: Callable[[Float32], Float32]

    def __call__(self, colors: Float32) -> Float32:
        """(N, 3) the viewer's colors of Gaussians for the model's, at least 0."""
        light = self.of_light(np.power(np.maximum(colors, np.float32(0.0)), np.float32(GAMMA)))
        return np.power(np.maximum(light, np.float32(1e-7)), np.float32(1.0 / GAMMA))

    def slope(self, colors: Float32) -> Float32:
        """(N, 3) how much of a small change of each channel is seen in this channel."""
        step = np.float32(_VIEWER.step)
        below = np.maximum(colors - step, np.float32(0.0))
        return np.asarray((self(colors + step) - self(below)) / (colors + step - below), dtype=np.float32)


def _aces(x: Float32) -> Float32:
    """Narkowicz (2015)."""
    return np.asarray((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14), dtype=np.float32)


_ACES_IN = np.array([[0.59719, 0.35458, 0.04823], [0.076, 0.90834, 0.01566], [0.0284, 0.13383, 0.83777]], np.float32)
_ACES_OUT = np.array(
    [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]], np.float32
)


def _aces2(x: Float32) -> Float32:
    """Hill's fit of RRT and ODT."""
    v = (x / np.float32(0.6)) @ _ACES_IN.T
    fitted = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.432951) + 0.238081)
    return np.clip(fitted @ _ACES_OUT.T, 0.0, 1.0)


def _neutral(x: Float32) -> Float32:
    """Khronos PBR neutral."""
    least = x.min(axis=1, keepdims=True)
    x = x - np.where(least < 0.08, least - 6.25 * least * least, np.float32(0.04))
    start, room = np.float32(0.76), np.float32(0.24)
    peak = x.max(axis=1, keepdims=True)
    lower = 1.0 - room * room / np.maximum(peak + room - start, room)
    white = 1.0 - 1.0 / (0.15 * (peak - lower) + 1.0)
    pressed = x * (lower / np.maximum(peak, np.float32(1e-6)))
    return np.asarray(np.where(peak < start, x, pressed + (lower - pressed) * white), dtype=np.float32)


TONES = (ViewerTone("aces", _aces), ViewerTone("aces2", _aces2), ViewerTone("neutral", _neutral))
"""Those of PlayCanvas that differ from a curve of the blended picture. Its filmic one hardly does: four pictures read
0.87 to 1.05 times the z."""


def find_viewer_tone(
    model: GaussianModel, camera: Camera, settings: RasterSettings, picture: Float32
) -> ViewerTone | None:
    """Which of `TONES` the viewer of a picture (H, W, 3), 0..1, from this camera applied to every Gaussian of the
    model; None where none explains the picture clearly better."""
    tone = None
    # In a small view Gaussians thinner than a pixel are wider than in the picture, which a curve may seem to explain:
    # it only says whether to look again.
    for seen_from in (camera.with_side(_VIEWER.side), camera):
        tone = _tone_of(draw(model, seen_from, settings=settings), picture)
        if tone is None:
            break
    return tone


def _tone_of(plain: Rendering, picture: Float32) -> ViewerTone | None:
    """Which of `TONES` explains a picture clearly better than the plain render, all compared at one small size."""
    camera = plain.view.camera
    small = camera.with_side(min(_VIEWER.side, max(camera.width, camera.height)))

    def reduced(image: Float32) -> Float32:
        return resized(np.clip(image, 0.0, 1.0), small.width, small.height)

    seen, unchanged = reduced(picture), reduced(plain.image)
    solid: Bool = (reduced(plain.alpha) > _VIEWER.solid) & (seen.max(axis=2) < _VIEWER.clipped)
    if int(solid.sum()) < _VIEWER.least_pixels:
        return None
    shown = {tone: reduced(plain.view.render(tone(plain.colors))[0]) for tone in TONES}
    misses = {tone: _missed_by_line(image, seen, solid) for tone, image in shown.items()}
    best = min(misses, key=lambda tone: misses[tone])
    if misses[best] > _VIEWER.better * _missed_by_line(unchanged, seen, solid):
        return None
    # A curve of the blended picture may do as well.
    blended, own = (
        float(np.median(np.abs(fit_tone(image, seen, solid, _VIEWER.knots).predicted - seen)[solid]))
        for image in (unchanged, shown[best])
    )
    return best if own < _VIEWER.better * blended else None


def _missed_by_line(image: Float32, seen: Float32, solid: Bool) -> float:
    """Median error of the best affine change of colors."""
    colors = image[solid]
    design = np.concatenate([colors, np.ones((len(colors), 1), dtype=np.float32)], axis=1)  # (P, 4)
    errors = [
        np.abs(design @ robust_regression(design, seen[solid][:, c], rounds=2).astype(np.float32) - seen[solid][:, c])
        for c in range(3)
    ]
    return float(np.median(errors))


_ORDERS = [(i, j) for i in range(_LIGHT.degree + 1) for j in range(_LIGHT.degree + 1 - i) if i + j > 0]
"""Polynomials down and across, of total degree 1 to `degree`."""


def fit_light(
    predicted: Float32, picture: Float32, mask: Bool, least_explained: float = _LIGHT.uneven
) -> Float32 | None:
    """Smooth gain (H, W) of a picture's brightness over what was predicted: the reference, toned like it; both (H, W),
    0..1.

    None where the light is even (the gain must take the share `least_explained` off the residual's median), or too
    little is seen in `mask` to tell.
    """
    height, width = predicted.shape
    where = np.flatnonzero(mask & (picture < _LIGHT.clipped) & (predicted > _LIGHT.black))
    where = where[:: max(1, len(where) // _LIGHT.samples)]
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
    weights = np.zeros((_LIGHT.degree + 1, _LIGHT.degree + 1), dtype=np.float32)
    for (i, j), value in zip(_ORDERS, solution, strict=False):
        weights[i, j] = value
    uneven = down @ weights @ across.T + (waves @ solution[len(_ORDERS) : count])[:, None]
    # Over a small object the functions may add up to a constant, which belongs to the tone: it would run away.
    uneven -= np.average(uneven.ravel()[where], weights=expected)
    return np.clip(1.0 + uneven, *_LIGHT.gains).astype(np.float32)


@lru_cache(maxsize=8)
def _functions(height: int, width: int) -> tuple[Float32, Float32, Float32]:
    """Legendre polynomials across (W, D + 1) and down (H, D + 1), and cosines down (H, waves)."""
    x, y = ((2.0 * np.arange(n) + 1.0) / n - 1.0 for n in (width, height))
    across, down = (np.polynomial.legendre.legvander(axis, _LIGHT.degree) for axis in (x, y))
    waves = np.cos(0.5 * np.pi * (y[:, None] + 1.0) * np.arange(1, _LIGHT.waves + 1))
    return across.astype(np.float32), down.astype(np.float32), waves.astype(np.float32)


def fit_colors(reference: Float32, picture: Float32, mask: Bool) -> Toned:
    """Tone and uneven light by turns, each on what the other leaves; even light costs no second round.

    `reference` and `picture` (H, W, 3), 0..1, in register; `mask` (H, W), pixels to fit on. The slope returned is that
    of the tone times the gain of the light.
    """
    toned = fit_tone(reference, picture, mask, _LIGHT.tone_knots)
    gain = np.ones(mask.shape, dtype=np.float32)
    for number in range(_LIGHT.color_rounds):
        least = _LIGHT.still_uneven if number else _LIGHT.uneven
        light = fit_light(toned.predicted @ LUMA, picture @ LUMA, mask, least)
        if light is None:
            break
        gain = gain * light
        toned = fit_tone(reference * gain[..., None], picture, mask, _LIGHT.tone_knots)
    return Toned(toned.predicted, toned.slope * gain[..., None])


def predict_brightness(reference: Float32, picture: Float32, inside: Bool) -> Float32:
    """(H, W) brightness of a picture in register with its reference, both (H, W) and 0..1, from the pixels `inside`
    that it shows: any tone curve and uneven light, by medians.

    Coarser than `fit_colors`, but hardly a caption or a painted corner moves it: it decides what counts as evidence.
    """
    lit = reference
    predicted = _through_curve(lit, picture, inside)
    for number in range(_LIGHT.curve_rounds):
        light = fit_light(predicted, picture, inside, _LIGHT.still_uneven if number else _LIGHT.uneven)
        if light is None:
            break
        lit = lit * light
        predicted = _through_curve(lit, picture, inside)
    return predicted


def _through_curve(lit: Float32, picture: Float32, inside: Bool) -> Float32:
    """Medians of the picture over bins of equally many pixels, joined by lines, never falling."""
    where = np.flatnonzero(inside)
    where = where[:: max(1, len(where) // _LIGHT.curve_samples)]
    if len(where) < _LIGHT.curve_bins:
        return lit
    x, y = lit.ravel()[where], picture.ravel()[where]
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, _LIGHT.curve_bins)
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
