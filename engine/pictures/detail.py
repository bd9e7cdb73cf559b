"""Whether the details of a picture are those of a render: a light and a dark part is in every other scene, too.

Nothing here sees a key or a chip.
"""

import numpy as np

from engine.model import Bool, Camera, Float32
from engine.numerics.resampling import resized, smooth

__all__ = ["compare_detail", "correlation"]

DETAIL = (1 / 160, 3 / 160)
"""Blurs between which detail lies, longer sides of the picture: a light and a dark part, which every other scene has
somewhere, are coarser; noise, compression and a picture out of focus are finer."""
DETAIL_SIZE = 320
"""Longer side of the picture on which detail is compared, pixels."""
LEAST_COVER = 0.1
"""Pixels of it of which a smaller part is usable are left out."""


def correlation(a: Float32, b: Float32) -> float:
    """Of two arrays of one size, -1 to 1; 0 where one says nothing."""
    a, b = a - a.mean(dtype=np.float64), b - b.mean(dtype=np.float64)
    both = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return float(np.sum(a * b)) / both if both > 1e-12 else 0.0


def compare_detail(toned: Float32, seen: Float32, cover: Float32, used: Bool, camera: Camera) -> tuple[float, float]:
    """Correlation of the details of render and picture (H, W) that do not follow from its opacity `cover`, and in
    standard deviations."""
    small = camera.with_side(min(DETAIL_SIZE, max(used.shape)))
    inside, *planes = (
        resized(np.where(used, each, 0.0).astype(np.float32), small.width, small.height)
        for each in (np.ones_like(seen), toned, seen, cover)
    )
    shown = inside > LEAST_COVER
    if not shown.any():
        return 0.0, 0.0
    fine, coarse = (share * max(small.width, small.height) for share in DETAIL)
    around = smooth(inside, fine)[shown], smooth(inside, coarse)[shown]
    a, b, c = (smooth(each, fine)[shown] / around[0] - smooth(each, coarse)[shown] / around[1] for each in planes)
    alike = correlation(_beyond(a, c), _beyond(b, c))
    # As many independent values as areas of the blur; Fisher (1915) for their correlation.
    independent = shown.sum() / (4.0 * np.pi * fine * fine)
    return alike, float(np.arctanh(np.clip(alike, -0.999, 0.999)) * np.sqrt(independent))


def _beyond(values: Float32, cover: Float32) -> Float32:
    """(M,) values without their best multiple of the cover."""
    return values - cover * np.float32(np.sum(values * cover) / max(float(np.sum(cover * cover)), 1e-12))
