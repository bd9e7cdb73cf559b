"""Whether the details of a picture are those of a render: a light and a dark part is in every other scene, too.

Nothing here sees a key or a chip.
"""

from typing import NamedTuple

import numpy as np

from engine.model import Bool, Camera, Float32
from engine.numerics.resampling import resized, smooth
from engine.pictures.alignment.config import CONFIG

_CONFIG = CONFIG.detail


def correlation(a: Float32, b: Float32) -> float:
    """Of two arrays of one size, -1 to 1; 0 where one says nothing."""
    a, b = a - a.mean(dtype=np.float64), b - b.mean(dtype=np.float64)
    both = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return float(np.sum(a * b)) / both if both > 1e-12 else 0.0


def uncovered(residual: Float32, used: Bool, spread: float) -> Bool:
    """(H, W) the pixels used without the cells that something lies over: at most `most_covered`, those of the largest
    `residual` (H, W), of this robust standard deviation. Right cameras under panels correlate by 0.90 and more so, by
    0.73 with them."""
    import cv2

    height, width = used.shape
    side = max(height, width) / _CONFIG.cells
    shape = max(1, round(width / side)), max(1, round(height / side))
    there, off = (
        cv2.resize(each.astype(np.float32), shape, interpolation=cv2.INTER_AREA).ravel()
        for each in (used, np.where(used, np.square(residual), 0.0))
    )
    order = np.argsort(-off / np.maximum(there, 1e-6), kind="stable")
    share = np.cumsum(there[order]) / max(float(there.sum()), 1e-9)
    over = (share <= _CONFIG.most_covered) & (off[order] > (_CONFIG.covered * spread) ** 2 * there[order])
    covered = np.zeros(len(order), dtype=np.uint8)
    covered[order[over]] = 1
    return np.asarray(
        used & (cv2.resize(covered.reshape(shape[::-1]), (width, height), interpolation=cv2.INTER_NEAREST) == 0)
    )


class DetailAgreement(NamedTuple):
    """How well details of a picture agree with those of a render."""

    correlation: float  # -1..1
    z: float  # in standard deviations of the correlation of unrelated details


def compare_detail(toned: Float32, seen: Float32, cover: Float32, used: Bool, camera: Camera) -> DetailAgreement:
    """Agreement of the details of render and picture (H, W) that do not follow from its opacity `cover`."""
    small = camera.with_side(min(_CONFIG.side, max(used.shape)))
    inside, *planes = (
        resized(np.where(used, each, 0.0).astype(np.float32), small.width, small.height)
        for each in (np.ones_like(seen), toned, seen, cover)
    )
    shown = inside > _CONFIG.least_cover
    if not shown.any():
        return DetailAgreement(0.0, 0.0)
    fine, coarse = (share * max(small.width, small.height) for share in _CONFIG.blurs)
    around = smooth(inside, fine)[shown], smooth(inside, coarse)[shown]
    a, b, c = (smooth(each, fine)[shown] / around[0] - smooth(each, coarse)[shown] / around[1] for each in planes)
    alike = correlation(_beyond(a, c), _beyond(b, c))
    # As many independent values as areas of the blur; Fisher (1915) for their correlation.
    independent = shown.sum() / (4.0 * np.pi * fine * fine)
    z = float(np.arctanh(np.clip(alike, -0.999, 0.999)) * np.sqrt(independent))
    return DetailAgreement(alike, z)


def _beyond(values: Float32, cover: Float32) -> Float32:
    """(M,) values without their best multiple of the cover."""
    return values - cover * np.float32(np.sum(values * cover) / max(float(np.sum(cover * cover)), 1e-12))
