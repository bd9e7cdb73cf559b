"""Tone curves of viewers that apply them to every Gaussian before blending, as PlayCanvas and so SuperSplat do.

A curve of blended colors is another picture: half of a bright Gaussian over a dark one is not what half of their
curves is. Where such a viewer made a picture, the reference is drawn with the same curve, found by which render
explains the picture; what is left is fitted as for any picture (`tone_curve`).

Nothing here sees a key or a chip.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from engine.model import Bool, Float32
from engine.numerics.resampling import resized
from engine.pictures.alignment.config import CONFIG
from engine.pictures.alignment.tone_curve import fit_tone, robust_regression
from engine.raster import View

__all__ = ["TONES", "ViewerTone", "find_viewer_tone"]

_CONFIG = CONFIG.viewer_tone
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
        step = np.float32(_CONFIG.step)
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


def find_viewer_tone(view: View, colors: Float32, alpha: Float32, picture: Float32) -> ViewerTone | None:
    """Which of `TONES` the viewer applied to every Gaussian, None where none explains the picture clearly better.

    Parameters
    ----------
    view : View
        Of the reference, from the picture's camera reduced to some `side` pixels.
    colors : (N, 3)
        The Gaussians' own, as seen from there.
    alpha : (h, w)
        The view's opacity.
    picture : (H, W, 3)
        0..1, of any size.
    """
    seen = resized(picture, view.camera.width, view.camera.height)
    solid: Bool = (alpha > _CONFIG.solid) & (seen.max(axis=2) < _CONFIG.clipped)
    if int(solid.sum()) < _CONFIG.least_pixels:
        return None

    def drawn(tone: ViewerTone | None) -> Float32:
        return np.clip(view.render(colors if tone is None else tone(colors))[0], 0.0, 1.0)

    plain = drawn(None)
    shown = {tone: drawn(tone) for tone in TONES}
    misses = {tone: _missed_by_line(image, seen, solid) for tone, image in shown.items()}
    best = min(misses, key=lambda tone: misses[tone])
    if misses[best] > _CONFIG.better * _missed_by_line(plain, seen, solid):
        return None
    # A curve of the blended picture may do as well.
    blended, own = (
        float(np.median(np.abs(fit_tone(image, seen, solid, _CONFIG.knots).predicted - seen)[solid]))
        for image in (plain, shown[best])
    )
    return best if own < _CONFIG.better * blended else None


def _missed_by_line(image: Float32, seen: Float32, solid: Bool) -> float:
    """Median error of the best affine change of colors."""
    colors = image[solid]
    design = np.concatenate([colors, np.ones((len(colors), 1), dtype=np.float32)], axis=1)  # (P, 4)
    errors = [
        np.abs(design @ robust_regression(design, seen[solid][:, c], rounds=2).astype(np.float32) - seen[solid][:, c])
        for c in range(3)
    ]
    return float(np.median(errors))
