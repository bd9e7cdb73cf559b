"""Where in a picture the model's viewer ends: a page around it, black bars, a player's edge (DESIGN 4.8).

A model that is larger than the viewer goes on, in a render, where the picture shows the page. Sides are cut off as
long as what they should show of the model is mostly not there; what is left is a picture that was cropped.

Nothing here sees a key or a chip.
"""

import math

import numpy as np

from engine.model import Camera, Float32, GaussianModel
from engine.numerics.resampling import resized, smooth
from engine.pictures.camera.config import CONFIG
from engine.pictures.landmarks.keypoints import luma
from engine.raster import render_depth

_CONFIG = CONFIG.frame


def find_frame(model: GaussianModel, gray: Float32, camera: Camera) -> tuple[slice, slice] | None:
    """Rows and columns of a picture's brightness (H, W) within which it shows what this camera sees; None where that is
    everywhere, or hardly anywhere."""
    import cv2

    small = camera.with_side(_CONFIG.side)
    image, alpha, _ = render_depth(model, small)
    # What lies behind the model is not in the render: only what is well within its outline is compared.
    solid = cv2.erode((alpha > _CONFIG.solid).astype(np.float32), np.ones((5, 5), np.uint8))
    if not solid.any():
        return None
    weight = _wrong(luma(image), resized(gray, small.width, small.height), solid) * solid
    top, bottom, left, right = 0, small.height, 0, small.width
    for _ in range(_CONFIG.rounds):
        rows = weight[:, left:right].sum(axis=1)
        top, bottom = _cut(rows), small.height - _cut(rows[::-1])
        if bottom - top < 2:
            return None
        columns = weight[top:bottom].sum(axis=0)
        left, right = _cut(columns), small.width - _cut(columns[::-1])
        if right - left < 2:
            return None
    within = float(solid[top:bottom, left:right].sum() / solid.sum())
    if not _CONFIG.least_inside < within < 1.0 - _CONFIG.least_outside:
        return None
    across = slice(*_enlarged(left, right, small.width, camera.width))
    return slice(*_enlarged(top, bottom, small.height, camera.height)), across


def _enlarged(low: int, high: int, small: int, large: int) -> tuple[int, int]:
    """A range of small pixels in large ones, one inside: its edge runs through an unknown one."""
    scale = large / small
    return math.ceil((low + (low > 0)) * scale), math.floor((high - (high < small)) * scale)


def _wrong(shown: Float32, seen: Float32, solid: Float32) -> Float32:
    """(H, W) 1 where the picture's brightness does not correlate with the render's, -1 where it does, 0 where the
    render has no texture; over solid pixels only."""
    share = np.maximum(smooth(solid, _CONFIG.window), np.float32(1e-3))

    def mean(values: Float32) -> Float32:
        return np.asarray(smooth(values * solid, _CONFIG.window) / share, dtype=np.float32)

    a, b = smooth(shown, _CONFIG.blur), smooth(seen, _CONFIG.blur)
    a, b = a - mean(a), b - mean(b)
    vary, varied, both = mean(a * a), mean(b * b), mean(a * b)
    alike = both > _CONFIG.alike * np.sqrt(np.maximum(vary * varied, np.float32(1e-12)))
    return np.where(vary > _CONFIG.texture**2, np.where(alike, -1.0, 1.0), 0.0).astype(np.float32)


def _cut(weights: np.ndarray) -> int:
    """How many of the first to leave out, so that what is left out is wrong rather than right."""
    sums = np.cumsum(weights)
    best = int(np.argmax(sums))
    return best + 1 if sums[best] > 0 else 0
