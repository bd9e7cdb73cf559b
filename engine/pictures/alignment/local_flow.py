"""Lay a picture of a bent model over the reference, part by part: no camera explains it (DESIGN 4.8).

1. Where the picture fits its camera's view, neighbourhood by neighbourhood, nothing is done.
2. Dense optical flow of brightness at half size, forth and back: what the two agree on is kept, between it the flow is
   filled in smoothly. Where the picture hardly fits better by it, nothing is done.
3. Gauss-Newton in small windows at full size, to a few hundredths of a pixel; its gradients are those of the noise-free
   render.
4. Only where a clear share of the model fits that did not before is the picture carried over; what does not fit then
   is masked.

Nothing here sees a key or a chip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.model import Bool, Float32
from engine.numerics.resampling import remap, resized, smooth
from engine.pictures.alignment.uneven_light import predict_brightness
from engine.pictures.landmarks.keypoints import luma

__all__ = ["LocalAlignment", "align_locally"]

OPAQUE = 0.5
"""Opacity of the reference below which a pixel does not say where the model is."""
AROUND = 8.0
"""Blur of the windows in which correlation is measured and the flow is refined, pixels: with 5, four pictures read
between the same and 3 % worse."""
FITS = 0.9
"""Correlation of a neighbourhood from which it fits."""
WELL = 0.85
"""Share of the model that fits above which nothing is looked for."""
BETTER = 0.04
"""Share of the model that must fit more at half size, by the rough flow, for more to be done: of 20 pictures that need
no bending 17 came to less, none of those that do."""
TELLING = 256
"""Longer side of the half-sized picture below which that does not tell, pixels; there the rest costs little."""
CLEAR = 0.06
"""Share of the model that must fit more than before in the end."""
KEPT = 0.8
"""Correlation of a neighbourhood below which it is masked once it was carried over."""
CONSISTENT = 1.0
"""Pixels of half the size by which the flow forth and back may disagree."""
MEDIAN = 5
"""Side of the median that takes single wrong vectors out of the flow, pixels of half the size."""
FILLED = 4.0
"""Blur by which the flow is filled in where the two do not agree, pixels."""
ROUNDS, FARTHEST = 6, 1.0
"""Of the refinement, and the motion of a round at most, pixels."""
BLUR = 0.8
"""Of both images before they are compared, pixels, as cameras are refined."""
OUTLYING = 2.5
"""Robust standard deviations from which a residual counts half."""
WRONG = 0.06, 5.0
"""A difference that is masked: more than this of brightness, and so many times the usual."""
MARGIN = 2
"""Pixels by which the mask is eroded."""


@dataclass(frozen=True, eq=False)
class LocalAlignment:
    """A picture carried over to the reference's pixels, part by part."""

    warped: Float32  # (H, W, 3)
    mask: Bool  # (H, W) where it fits
    flow: Float32  # (H, W, 2) x, y from a pixel of the reference to its place in the picture, pixels


def align_locally(reference_image: Float32, alpha: Float32, picture: Float32) -> LocalAlignment | None:
    """Carry a picture over to the render of the reference from its camera, both (H, W, 3), 0..1; `alpha` (H, W) is that
    render's opacity.

    None where the picture fits as it is, or hardly fits better anywhere when bent.
    """
    shown = alpha > OPAQUE
    if not shown.any():
        return None
    gray, seen = luma(reference_image), luma(picture)
    rough = _rough(*(_halved(each) for each in (gray, seen, alpha)))
    if rough is None:
        return None
    flow, agreed = (_doubled(each, gray.shape) for each in rough)
    expected = predict_brightness(gray, seen, shown)
    before = _correlation(expected, seen, shown, AROUND)[shown] > FITS
    used = (shown & (agreed > 0.5)).astype(np.float32)
    flow = _filled(flow, used, FILLED)
    for _ in range(ROUNDS):
        flow = flow + _step(expected, picture, flow, used)
    warped, inside = remap(picture, _positions(flow))
    there = luma(warped)
    expected = predict_brightness(gray, there, inside & shown)
    alike = _correlation(expected, there, shown & inside, AROUND)
    after = alike[shown] > FITS
    if after.mean() - before.mean() < CLEAR:
        return None
    return LocalAlignment(warped, _fitting(expected, there, alike, shown & inside), flow)


def _rough(gray: Float32, seen: Float32, alpha: Float32) -> tuple[Float32, Float32] | None:
    """(H, W, 2) flow from a render to a picture, brightness (H, W), in pixels, and (H, W) 1 where it leads back; None
    where the picture fits as it is, or hardly better."""
    shown = alpha > OPAQUE
    if not shown.any():
        return None
    expected = predict_brightness(gray, seen, shown)
    before = (_correlation(expected, seen, shown, AROUND / 2)[shown] > FITS).mean()
    if before > WELL:
        return None
    flow, agreed = _dense(expected, seen)
    near = _filled(flow, (shown & agreed).astype(np.float32), FILLED / 2)
    there, inside = remap(seen[..., None], _positions(near))
    expected = predict_brightness(gray, there[..., 0], inside & shown)
    after = (_correlation(expected, there[..., 0], shown & inside, AROUND / 2)[shown] > FITS).mean()
    better = after - before > BETTER or max(seen.shape) < TELLING
    return (flow, agreed.astype(np.float32)) if better else None


def _halved(image: Float32) -> Float32:
    """An image (H, W) at half its size."""
    height, width = image.shape
    return resized(image, max(width // 2, 1), max(height // 2, 1))


def _doubled(values: Float32, shape: tuple[int, ...]) -> Float32:
    """What was found at half size (h, w) or, of a flow in pixels, (h, w, 2), at an image's shape (H, W)."""
    import cv2

    height, width = shape
    scale = np.array([width / values.shape[1], height / values.shape[0]], dtype=np.float32)
    large = cv2.resize(values, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(scale * large if values.ndim == 3 else large)


def _dense(expected: Float32, seen: Float32) -> tuple[Float32, Bool]:
    """(H, W, 2) rough flow, and (H, W) where it leads back."""
    import cv2

    one, other = (np.round(255.0 * np.clip(each, 0.0, 1.0)).astype(np.uint8) for each in (expected, seen))
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    search.setFinestScale(0)
    forth, back = search.calc(one, other, None), search.calc(other, one, None)
    returned, _ = remap(back, _positions(forth))
    agreed = np.linalg.norm(forth + returned, axis=2) < CONSISTENT
    flow = np.stack([cv2.medianBlur(np.ascontiguousarray(forth[..., axis]), MEDIAN) for axis in (0, 1)], axis=2)
    return np.asarray(flow), np.asarray(agreed)


def _step(expected: Float32, picture: Float32, flow: Float32, used: Float32) -> Float32:
    """(H, W, 2) what to add to the flow: Gauss-Newton in windows."""
    warped, inside = remap(picture, _positions(flow))
    known = smooth(expected, BLUR)
    residual = smooth(luma(warped), BLUR) - known
    counted = inside & (used > 0)
    if not counted.any():
        return np.zeros_like(flow)
    gy, gx = (np.asarray(each) for each in np.gradient(known))
    spread = OUTLYING * (1.4826 * float(np.median(np.abs(residual[counted]))) + 1e-3)
    weight = counted / (1.0 + np.square(residual / spread))
    sums = (gx * gx, gx * gy, gy * gy, gx * residual, gy * residual)
    xx, xy, yy, bx, by = (smooth((weight * each).astype(np.float32), AROUND) for each in sums)
    xx, yy = xx + 1e-6, yy + 1e-6
    step = -np.stack([yy * bx - xy * by, xx * by - xy * bx], axis=2) / (xx * yy - xy * xy)[..., None]
    step *= np.minimum(1.0, FARTHEST / np.maximum(np.linalg.norm(step, axis=2, keepdims=True), 1e-6))
    return _filled(step.astype(np.float32), smooth((weight * (gx * gx + gy * gy)).astype(np.float32), 3.0), AROUND / 2)


def _fitting(expected: Float32, there: Float32, alike: Float32, shown: Bool) -> Bool:
    import cv2

    fits = shown & (alike > KEPT)
    off = smooth(np.where(fits, np.abs(there - expected), 0.0).astype(np.float32), 4.0)
    usual = float(np.median(off[fits])) if fits.any() else 0.0
    fits &= off <= max(WRONG[0], WRONG[1] * usual)
    size = 2 * MARGIN + 1
    return np.asarray(cv2.erode(fits.astype(np.uint8), np.ones((size, size), dtype=np.uint8)) > 0)


def _positions(flow: Float32) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """(H, W, 2) where the flow leads, pixel coordinates."""
    height, width = flow.shape[:2]
    row, column = np.mgrid[0:height, 0:width].astype(np.float64) + 0.5
    return np.stack([column, row], axis=2) + flow


def _filled(values: Float32, weight: Float32, sigma: float) -> Float32:
    """(H, W, C) blurred, each pixel by its weight (H, W)."""
    total = smooth(weight, sigma) + np.float32(1e-6)
    return smooth(values * weight[..., None], sigma) / total[..., None]


def _correlation(one: Float32, other: Float32, used: Bool, around: float) -> Float32:
    """(H, W) of two images in the neighbourhood of each pixel, a blur of so many pixels, of the pixels used."""
    weight = used.astype(np.float32)
    total = smooth(weight, around) + np.float32(1e-6)
    means = [smooth(weight * each, around) / total for each in (one, other)]
    squares = [
        smooth(weight * each * each, around) / total - mean * mean
        for each, mean in zip((one, other), means, strict=True)
    ]
    both = smooth(weight * one * other, around) / total - means[0] * means[1]
    return np.asarray(both / np.sqrt(np.maximum(squares[0] * squares[1], 1e-8)), dtype=np.float32)
