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

from dataclasses import dataclass

import numpy as np

from engine.model import Bool, Float32
from engine.numerics.resampling import remap, resized, smooth
from engine.pictures.alignment.config import CONFIG
from engine.pictures.alignment.tone_and_light import predict_brightness
from engine.pictures.landmarks.keypoints import luma

_CONFIG = CONFIG.flow


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
    shown = alpha > _CONFIG.opaque
    if not shown.any():
        return None
    gray, seen = luma(reference_image), luma(picture)
    rough = _rough(*(_halved(each) for each in (gray, seen, alpha)))
    if rough is None:
        return None
    flow, agreed = (_doubled(each, gray.shape) for each in rough)
    expected, alike = _compared(gray, seen, shown, _CONFIG.around)
    before = alike[shown] > _CONFIG.fits
    used = (shown & (agreed > 0.5)).astype(np.float32)
    flow = _filled(flow, used, _CONFIG.filled)
    for _ in range(_CONFIG.rounds):
        flow = flow + _step(expected, seen, flow, used)
    warped, inside = _moved(picture, flow)
    there = luma(warped)
    expected, alike = _compared(gray, there, shown & inside, _CONFIG.around)
    after = alike[shown] > _CONFIG.fits
    if after.mean() - before.mean() < _CONFIG.clear:
        return None
    return LocalAlignment(warped, _fitting(expected, there, alike, shown & inside), flow)


def _rough(gray: Float32, seen: Float32, alpha: Float32) -> tuple[Float32, Float32] | None:
    """(H, W, 2) flow from a render to a picture, brightness (H, W), in pixels, and (H, W) 1 where it leads back; None
    where the picture fits as it is, or hardly better."""
    shown = alpha > _CONFIG.opaque
    if not shown.any():
        return None
    expected, alike = _compared(gray, seen, shown, _CONFIG.around / 2)
    before = (alike[shown] > _CONFIG.fits).mean()
    if before > _CONFIG.well:
        return None
    flow, agreed = _dense(expected, seen)
    near = _filled(flow, (shown & agreed).astype(np.float32), _CONFIG.filled / 2)
    there, inside = _moved(seen[..., None], near)
    _, alike = _compared(gray, there[..., 0], shown & inside, _CONFIG.around / 2)
    after = (alike[shown] > _CONFIG.fits).mean()
    better = after - before > _CONFIG.better or max(seen.shape) < _CONFIG.telling
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
    returned, _ = _moved(back, forth)
    agreed = np.linalg.norm(forth + returned, axis=2) < _CONFIG.consistent
    flow = np.stack([cv2.medianBlur(np.ascontiguousarray(forth[..., axis]), _CONFIG.median) for axis in (0, 1)], axis=2)
    return np.asarray(flow), np.asarray(agreed)


def _step(expected: Float32, seen: Float32, flow: Float32, used: Float32) -> Float32:
    """(H, W, 2) what to add to the flow: Gauss-Newton in windows, of brightness."""
    warped, inside = _moved(seen[..., None], flow)
    known = smooth(expected, _CONFIG.blur)
    residual = smooth(warped[..., 0], _CONFIG.blur) - known
    counted = inside & (used > 0)
    if not counted.any():
        return np.zeros_like(flow)
    gy, gx = (np.asarray(each) for each in np.gradient(known))
    spread = _CONFIG.outlying * (1.4826 * float(np.median(np.abs(residual[counted]))) + 1e-3)
    weight = counted / (1.0 + np.square(residual / spread))
    sums = (gx * gx, gx * gy, gy * gy, gx * residual, gy * residual)
    xx, xy, yy, bx, by = (smooth((weight * each).astype(np.float32), _CONFIG.around) for each in sums)
    xx, yy = xx + 1e-6, yy + 1e-6
    step = -np.stack([yy * bx - xy * by, xx * by - xy * bx], axis=2) / (xx * yy - xy * xy)[..., None]
    step *= np.minimum(1.0, _CONFIG.farthest / np.maximum(np.linalg.norm(step, axis=2, keepdims=True), 1e-6))
    known = smooth((weight * (gx * gx + gy * gy)).astype(np.float32), 3.0)
    return _filled(step.astype(np.float32), known, _CONFIG.around / 2)


def _fitting(expected: Float32, there: Float32, alike: Float32, shown: Bool) -> Bool:
    import cv2

    fits = shown & (alike > _CONFIG.kept)
    off = smooth(np.where(fits, np.abs(there - expected), 0.0).astype(np.float32), 4.0)
    usual = float(np.median(off[fits])) if fits.any() else 0.0
    fits &= off <= max(_CONFIG.wrong, _CONFIG.wrong_spreads * usual)
    size = 2 * _CONFIG.margin + 1
    return np.asarray(cv2.erode(fits.astype(np.uint8), np.ones((size, size), dtype=np.uint8)) > 0)


def _moved(image: Float32, flow: Float32) -> tuple[Float32, Bool]:
    """An image (H, W, C) carried back along a flow from each pixel to its place in it; and where that lies inside."""
    height, width = flow.shape[:2]
    row, column = np.mgrid[0:height, 0:width].astype(np.float64) + 0.5
    return remap(image, np.stack([column, row], axis=2) + flow)


def _filled(values: Float32, weight: Float32, sigma: float) -> Float32:
    """(H, W, C) blurred, each pixel by its weight (H, W)."""
    total = smooth(weight, sigma) + np.float32(1e-6)
    return smooth(values * weight[..., None], sigma) / total[..., None]


def _compared(gray: Float32, seen: Float32, used: Bool, around: float) -> tuple[Float32, Float32]:
    """(H, W) the brightness of a render as the picture over it would show it, from the pixels used; and (H, W) the
    correlation of that with the picture's in the neighbourhood of each pixel, a blur of so many pixels."""
    expected = predict_brightness(gray, seen, used)
    weight = used.astype(np.float32)
    total = smooth(weight, around) + np.float32(1e-6)
    means = [smooth(weight * each, around) / total for each in (expected, seen)]
    squares = [
        smooth(weight * each * each, around) / total - mean * mean
        for each, mean in zip((expected, seen), means, strict=True)
    ]
    both = smooth(weight * expected * seen, around) / total - means[0] * means[1]
    return expected, np.asarray(both / np.sqrt(np.maximum(squares[0] * squares[1], 1e-8)), dtype=np.float32)
