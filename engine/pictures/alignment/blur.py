"""Blur of a picture, by a moving camera or a lens: one small kernel, from the reference's render and the picture alone.

1. A first look: both smoothed until blur acts as a diffusion, the picture is regressed on the render and its second
   derivatives. Their coefficients are half of the second moments of whatever kernel blurred it (Taylor), which tells
   whether it was blurred at all, and how far.
2. The kernel, every value free: regularized least squares of the picture's brightness on shifted renders, at the
   render's steepest pixels. A shift of the picture is a part of it.
3. It is one only if it explains the picture clearly better than the sharp render does.

Nothing here sees a key or a chip.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.model import Bool, Float32, Float64
from engine.numerics.resampling import resized, smooth
from engine.pictures.alignment.background import fill_background
from engine.pictures.alignment.brightness_fit import robust_scale
from engine.pictures.alignment.config import CONFIG

_CONFIG = CONFIG.blur


@dataclass(frozen=True, eq=False)
class Blur:
    """What blurred a picture: each of its pixels is the sum of the sharp picture's around it times `kernel`."""

    kernel: Float32  # (2 r + 1, 2 r + 1), sum 1

    def apply(self, image: Float32) -> Float32:
        """An image (H, W) or (H, W, C), blurred."""
        return _correlated(image, self.kernel)

    def adjoint(self, cotangent: Float32) -> Float32:
        """A cotangent of the blurred image (H, W, C), pulled back to the sharp one."""
        return _correlated(cotangent, self.kernel[::-1, ::-1])

    @property
    def widths(self) -> tuple[float, float]:
        """Standard deviations along its long and its short axis, pixels."""
        radius = len(self.kernel) // 2
        at, kernel = np.arange(-radius, radius + 1.0), self.kernel.astype(np.float64)
        x, y = at - kernel.sum(axis=0) @ at, at - kernel.sum(axis=1) @ at
        mixed = y @ kernel @ x
        return _widths(np.array([[kernel.sum(axis=0) @ x**2, mixed], [mixed, kernel.sum(axis=1) @ y**2]]))


def find_blur(sharp: Float32, alpha: Float32, seen: Float32, mask: Bool | None = None) -> Blur | None:
    """The blur of a picture over the reference's render in the same pixels, from the brightness of both (H, W), 0..1,
    and the render's opacity `alpha` (H, W); None where none is found.

    `mask` (H, W) are the pixels of the picture that may be trusted, by default all.
    """
    usable = (alpha > CONFIG.background.clear) & (seen < _CONFIG.clipped)
    if mask is not None:
        usable &= mask
    behind = fill_background(seen, alpha, _CONFIG.spill)
    if behind is not None:  # it was blurred together with the model
        sharp = sharp + (1.0 - alpha) * behind
    moments = _first_look(sharp, seen, usable)
    if moments is None or not _CONFIG.least_spread <= _widths(moments)[0] <= _CONFIG.widest:
        return None
    return _fit(sharp, seen, usable, _support(moments))


def _first_look(sharp: Float32, seen: Float32, usable: Bool) -> Float64 | None:
    """(2, 2) second moments of the kernel, pixels squared, x first; roughly."""
    half = _CONFIG.half
    width, height = sharp.shape[1] // half, sharp.shape[0] // half
    if min(width, height) < 2:
        return None
    inside, *planes = (resized(each, width, height) for each in (usable.astype(np.float32), sharp, seen))
    cover, base, other = (smooth(each, _CONFIG.look / half) for each in (inside, *planes))
    gy, gx = (np.asarray(each) for each in np.gradient(base))
    (gyy, gxy), gxx = np.gradient(gy), np.gradient(gx, axis=1)
    where = _steepest(gx * gx + gy * gy, (inside == 1.0) & (cover > 0.9))
    if len(where) < _CONFIG.least_samples:
        return None
    columns = (np.ones_like(base), base, gx, gy, gxx, gxy, gyy)
    design = np.stack([column.ravel()[where] for column in columns], axis=1).astype(np.float64)
    solution = np.linalg.solve(design.T @ design + 1e-12 * np.eye(7), design.T @ other.ravel()[where])
    gain, xx, xy, yy = solution[1], *solution[4:]
    return half**2 * np.array([[2.0 * xx, xy], [xy, 2.0 * yy]]) / gain if gain > 0 else None


def _support(moments: Float64) -> Bool:
    """(2 r + 1, 2 r + 1) where a kernel of about these moments may differ from zero."""
    values, vectors = np.linalg.eigh(moments)
    short, long = _CONFIG.reach * np.sqrt(np.maximum(values, 0.0)) + _CONFIG.margin
    radius = int(long)
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    across, along = (vectors[0, k] * x + vectors[1, k] * y for k in range(2))
    return np.asarray((across / short) ** 2 + (along / long) ** 2 <= 1.0)


def _fit(sharp: Float32, seen: Float32, usable: Bool, support: Bool) -> Blur | None:
    """The kernel on that support; None where the picture is hardly better explained by it."""
    radius, count = len(support) // 2, int(support.sum())
    gy, gx = (np.asarray(each) for each in np.gradient(smooth(sharp, 1.0)))
    inner = np.zeros_like(usable)
    inner[radius:-radius, radius:-radius] = usable[radius:-radius, radius:-radius]
    where = _steepest(gx * gx + gy * gy, inner)
    if len(where) < max(_CONFIG.least_samples, 4 * count):
        return None
    dy, dx = np.nonzero(support)
    shifts = (dy - radius) * sharp.shape[1] + dx - radius
    base, target = sharp.ravel(), seen.ravel()[where]
    offset = np.float32(base[where].mean())
    design = np.ones((len(where), count + 1), dtype=np.float32)  # (P, K + 1)
    design[:, :-1] = base[where[:, None] + shifts] - offset
    weight = np.ones(len(where), dtype=np.float32)
    for _ in range(_CONFIG.rounds):
        weighted = design * weight[:, None]
        normal = (weighted.T @ design).astype(np.float64)
        normal[np.diag_indices(count)] += _CONFIG.ridge * np.trace(normal[:-1, :-1]) / count
        solution = np.linalg.solve(normal, (weighted.T @ target).astype(np.float64))
        left = target - design @ solution.astype(np.float32)
        spread = robust_scale(left)
        weight = 1.0 / (1.0 + np.square(left / (_CONFIG.outlying * spread)))
    total = float(solution[:-1].sum())
    slope, level = np.polyfit(base[where].astype(np.float64), target.astype(np.float64), 1)
    unexplained = robust_scale(target - (slope * base[where] + level))
    if total < _CONFIG.least_sum or spread > _CONFIG.explained * unexplained:
        return None
    kernel = np.zeros(support.shape, dtype=np.float32)
    kernel[support] = solution[:-1] / total
    blur = Blur(kernel)
    return blur if blur.widths[0] <= _CONFIG.widest else None  # so free a kernel makes many a picture alike


def _steepest(energy: Float32, usable: Bool) -> npt.NDArray[np.intp]:
    """(P,) indices of the usable pixels of the largest energy, about as many as are sampled."""
    there, count = np.flatnonzero(usable), _CONFIG.samples
    if len(there) <= count:
        return there
    loud = energy.ravel()[there]
    return np.asarray(there[loud >= np.partition(loud, len(loud) - count)[len(loud) - count]])


def _correlated(image: Float32, kernel: Float32) -> Float32:
    import cv2

    return np.asarray(cv2.filter2D(image, -1, np.ascontiguousarray(kernel), borderType=cv2.BORDER_REFLECT))


def _widths(moments: Float64) -> tuple[float, float]:
    short, long = np.sqrt(np.maximum(np.linalg.eigvalsh(moments), 0.0))
    return float(long), float(short)
