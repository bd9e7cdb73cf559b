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
from functools import cached_property

import numpy as np
import numpy.typing as npt

from engine.model import Bool, Float32, Float64
from engine.numerics.resampling import resized, smooth
from engine.pictures.alignment.brightness_fit import robust_scale

__all__ = ["Blur", "find_blur"]

HALF, LOOK = 2, 4.0
"""The first look is taken at pictures of this part of the size, smoothed by so many pixels of the full one: wider than
the blurs that are read, or their Taylor series does not hold."""
LEAST_SPREAD = 1.1
"""Standard deviation, pixels, along its long axis, of a kernel that is looked for. The mark of a sharp picture looks
like 0.7; softer pictures than this are read well as they are."""
LEAST_WIDTH = 1.0
"""The same of the kernel that was fitted."""
WIDEST = 6.0
"""Standard deviation, pixels, of the widest kernel."""
REACH, MARGIN = 2.5, 2.5
"""The kernel's support is an ellipse of so many standard deviations, and so many pixels for what the first look missed
and for a shift."""
SAMPLES = 20_000
"""Pixels that tell the kernel, and the first look."""
RIDGE = 1e-5
"""Of the mean of the normal matrix's diagonal: what the render does not show is not made up."""
ROUNDS = 2
"""Of the robust fit."""
LINE = 0.5
"""A kernel whose short axis is below this share of the long one is told as a line."""
LEAST_SUM = 0.2
"""Of the fitted kernel, which is the picture's contrast: less is another picture."""
EXPLAINED = 0.8
"""A kernel must leave less than this share of what the sharp render misses by."""
_CLIPPED = 0.985
_LEAST = 2_000
"""Pixels below which nothing is told."""


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

    @cached_property
    def axes(self) -> tuple[float, float, float]:
        """Standard deviations along its long and its short axis, pixels, and the angle of the long one from the
        x axis towards the y axis, degrees in [0, 180)."""
        return _axes(_moments(self.kernel.astype(np.float64)))

    @property
    def described(self) -> str:
        """In words: a line or a spot, with its size in pixels."""
        long, short, angle = self.axes
        if short < LINE * long:
            return f"along a line of {np.sqrt(12.0) * long:.0f} pixels, {angle:.0f} degrees from the x axis"
        return f"by a spot of standard deviation {np.sqrt(long * short):.1f} pixels"


def find_blur(sharp: Float32, seen: Float32, mask: Bool) -> Blur | None:
    """The blur of a picture over the reference's render in the same pixels, from the brightness of both (H, W), 0..1;
    None where none is found.

    `mask` (H, W) are the pixels of the picture that show the model.
    """
    usable = mask & (seen < _CLIPPED)
    moments = _first_look(sharp, seen, usable)
    if moments is None or not LEAST_SPREAD <= _axes(moments)[0] <= WIDEST:
        return None
    return _fit(sharp, seen, usable, _support(moments))


def _first_look(sharp: Float32, seen: Float32, usable: Bool) -> Float64 | None:
    """(2, 2) second moments of the kernel, pixels squared, x first; roughly."""
    width, height = sharp.shape[1] // HALF, sharp.shape[0] // HALF
    if min(width, height) < 2:
        return None
    inside, *planes = (resized(each, width, height) for each in (usable.astype(np.float32), sharp, seen))
    cover, base, other = (smooth(each, LOOK / HALF) for each in (inside, *planes))
    gy, gx = (np.asarray(each) for each in np.gradient(base))
    (gyy, gxy), gxx = np.gradient(gy), np.gradient(gx, axis=1)
    where = _steepest(gx * gx + gy * gy, (inside == 1.0) & (cover > 0.9))
    if len(where) < _LEAST:
        return None
    columns = (np.ones_like(base), base, gx, gy, gxx, gxy, gyy)
    design = np.stack([column.ravel()[where] for column in columns], axis=1).astype(np.float64)
    solution = np.linalg.solve(design.T @ design + 1e-12 * np.eye(7), design.T @ other.ravel()[where])
    gain, xx, xy, yy = solution[1], *solution[4:]
    return HALF**2 * np.array([[2.0 * xx, xy], [xy, 2.0 * yy]]) / gain if gain > 0 else None


def _support(moments: Float64) -> Bool:
    """(2 r + 1, 2 r + 1) where a kernel of about these moments may differ from zero."""
    values, vectors = np.linalg.eigh(moments)
    short, long = REACH * np.sqrt(np.maximum(values, 0.0)) + MARGIN
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
    if len(where) < max(_LEAST, 4 * count):
        return None
    dy, dx = np.nonzero(support)
    shifts = (dy - radius) * sharp.shape[1] + dx - radius
    base, target = sharp.ravel(), seen.ravel()[where]
    offset = np.float32(base[where].mean())
    design = np.ones((len(where), count + 1), dtype=np.float32)  # (P, K + 1)
    design[:, :-1] = base[where[:, None] + shifts] - offset
    weight = np.ones(len(where), dtype=np.float32)
    for _ in range(ROUNDS):
        weighted = design * weight[:, None]
        normal = (weighted.T @ design).astype(np.float64)
        normal[np.diag_indices(count)] += RIDGE * np.trace(normal[:-1, :-1]) / count
        solution = np.linalg.solve(normal, (weighted.T @ target).astype(np.float64))
        left = target - design @ solution.astype(np.float32)
        spread = robust_scale(left)
        weight = 1.0 / (1.0 + np.square(left / (3.0 * spread)))
    total = float(solution[:-1].sum())
    slope, level = np.polyfit(base[where].astype(np.float64), target.astype(np.float64), 1)
    unexplained = robust_scale(target - (slope * base[where] + level))
    if total < LEAST_SUM or spread > EXPLAINED * unexplained:
        return None
    kernel = np.zeros(support.shape, dtype=np.float32)
    kernel[support] = solution[:-1] / total
    found = Blur(kernel)
    return found if found.axes[0] >= LEAST_WIDTH else None


def _steepest(energy: Float32, usable: Bool) -> npt.NDArray[np.intp]:
    """(P,) indices of the usable pixels of the largest energy, about `SAMPLES` of them."""
    there = np.flatnonzero(usable)
    if len(there) <= SAMPLES:
        return there
    loud = energy.ravel()[there]
    return np.asarray(there[loud >= np.partition(loud, len(loud) - SAMPLES)[len(loud) - SAMPLES]])


def _correlated(image: Float32, kernel: Float32) -> Float32:
    import cv2

    return np.asarray(cv2.filter2D(image, -1, np.ascontiguousarray(kernel), borderType=cv2.BORDER_REFLECT))


def _moments(kernel: Float64) -> Float64:
    """(2, 2) central second moments, x first."""
    radius = len(kernel) // 2
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    mx, my = float((kernel * x).sum()), float((kernel * y).sum())
    xx, xy, yy = (float((kernel * each).sum()) for each in ((x - mx) ** 2, (x - mx) * (y - my), (y - my) ** 2))
    return np.array([[xx, xy], [xy, yy]])


def _axes(moments: Float64) -> tuple[float, float, float]:
    values, vectors = np.linalg.eigh(moments)
    short, long = np.sqrt(np.maximum(values, 0.0))
    return float(long), float(short), float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])) % 180.0)
