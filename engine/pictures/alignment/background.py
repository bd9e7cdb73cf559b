"""What a picture shows behind a model: an unknown viewer, page or photograph (DESIGN 4.8).

A pixel of a suspect is what the model adds, and what lies behind times what the model lets through. Where the render of
the reference is clear, the picture shows what lies behind; elsewhere it is filled in from there, coarser the farther
away. What it adds is then taken off the picture, so that picture and reference both lie over black.

Nothing here sees a key or a chip.
"""

from dataclasses import dataclass

import numpy as np

from engine.model import Bool, Float32
from engine.numerics.resampling import smooth
from engine.pictures.alignment.config import CONFIG

_CONFIG = CONFIG.background


@dataclass(frozen=True, eq=False)
class Background:
    """What a picture shows behind a model."""

    through: Float32  # (H, W, 3) as much of it as shines through the model
    trusted: Bool  # (H, W) where that is known well enough


def find_background(picture: Float32, alpha: Float32) -> Background | None:
    """What lies behind the reference in a picture (H, W, 3), pixel on pixel over its render of opacity `alpha` (H, W);
    None where that is black, or hardly to be seen."""
    filled = fill_background(picture, alpha)
    if filled is None or float(np.abs(filled).mean()) < _CONFIG.black:
        return None
    # How far cells are off what their surroundings say: nothing over a plain colour, much over a photograph.
    around = fill_background(picture, alpha, finest=_CONFIG.around)
    assert around is not None
    rough = fill_background(np.square(smooth(picture - around, _CONFIG.finest)).mean(axis=2), alpha)
    assert rough is not None
    clear = 1.0 - alpha
    trusted = clear * np.sqrt(np.maximum(rough, 0.0)) < _CONFIG.tolerated
    return Background(clear[..., None] * filled, trusted & (alpha > _CONFIG.clear))


def fill_background(
    picture: Float32, alpha: Float32, margin: int = _CONFIG.margin, finest: int = _CONFIG.finest
) -> Float32 | None:
    """(H, W) or (H, W, C) what lies behind the reference, of the picture's shape; None where too little is clear.

    `alpha` (H, W) is the opacity of the reference's render in the picture's pixels, right within `margin` pixels;
    nothing smaller than `finest` pixels is resolved.
    """
    import cv2

    height, width = alpha.shape
    window = np.ones((2 * margin + 1, 2 * margin + 1), dtype=np.uint8)
    clear = (cv2.dilate(alpha, window) < _CONFIG.clear).astype(np.float32)
    if clear.mean() < _CONFIG.least_share:
        return None
    planes = picture.reshape(height, width, -1)
    # Sums and counts of clear pixels, coarser and coarser; then down again, each cell mixed with what is around it.
    sums, counts = planes * clear[..., None], clear
    levels: list[tuple[Float32, Float32]] = []
    step = finest
    while True:
        shape = max(1, round(alpha.shape[1] / step)), max(1, round(alpha.shape[0] / step))
        sums, counts = (cv2.resize(each, shape, interpolation=cv2.INTER_AREA) for each in (sums, counts))
        sums = sums.reshape(*counts.shape, -1)
        levels.append((sums, counts))
        if max(shape) == 1:
            break
        step *= 2
    filled = levels[-1][0] / np.maximum(levels[-1][1], 1e-6)[..., None]
    for sums, counts in levels[-2::-1]:
        around = cv2.resize(filled, counts.shape[::-1], interpolation=cv2.INTER_LINEAR).reshape(sums.shape)
        filled = (sums + _CONFIG.trust * around) / (counts + _CONFIG.trust)[..., None]
    full = cv2.resize(filled, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(full, dtype=np.float32).reshape(picture.shape)
