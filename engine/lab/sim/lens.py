"""Lenses in normalized image coordinates (focal length 1, axis at 0): where a pinhole's point is really seen.

Two families: Brown and Conrady's radial-tangential one with OpenCV's names and signs, and fisheyes that bend the
angle from the axis.
"""

from dataclasses import dataclass

import numpy as np

from engine.errors import InputError
from engine.model import Float64

__all__ = ["BrownLens", "FisheyeLens"]

_NEWTON_STEPS = 30
_CLOSE = 1e-10


@dataclass(frozen=True)
class BrownLens:
    """Radial-tangential distortion x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + tangential (OpenCV's `calib3d`).

    A negative k1 is a barrel, a positive one a pincushion; p1 and p2 are of a lens that is not quite centred.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite([self.k1, self.k2, self.k3, self.p1, self.p2]).all():
            raise InputError(f"lens coefficients must be finite, got {self}")

    def distort(self, points: Float64) -> Float64:
        """(..., 2) where the lens shows the pinhole's points (..., 2)."""
        x, y = points[..., 0], points[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        across = x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x)
        down = y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y
        return np.stack([across, down], axis=-1)

    def undistort(self, points: Float64) -> Float64:
        """(..., 2) the pinhole's points that are seen at (..., 2), by Newton; NaN where there are none."""
        points = np.asarray(points, dtype=np.float64)
        at = points.copy()
        for _ in range(_NEWTON_STEPS):
            missing = points - self.distort(at)
            if np.abs(missing).max(initial=0.0) < _CLOSE:
                break
            a, b, d = self._jacobian(at)
            # Beyond the fold the picture turns back on itself: no step across it.
            scale = np.maximum(a * d - b * b, 0.1)
            dx, dy = missing[..., 0], missing[..., 1]
            step = np.stack([d * dx - b * dy, a * dy - b * dx], axis=-1)
            at = np.clip(at + step / scale[..., None], -1e3, 1e3)
        a, b, d = self._jacobian(at)
        found = (np.abs(points - self.distort(at)).max(axis=-1) < 1e-7) & (a * d - b * b > 0) & (a + d > 0)
        return np.where(found[..., None], at, np.nan)

    def _jacobian(self, points: Float64) -> tuple[Float64, Float64, Float64]:
        """xx, xy (which is yx, too) and yy of d distort / d point."""
        x, y = points[..., 0], points[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = self.k1 + r2 * (2.0 * self.k2 + 3.0 * self.k3 * r2)  # d radial / d r^2
        a = radial + 2.0 * x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x
        d = radial + 2.0 * y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x
        b = 2.0 * x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y
        return a, b, d


@dataclass(frozen=True)
class FisheyeLens:
    """r' = tan((1 - bend) theta) / (1 - bend) for the angle theta = atan(r) from the axis.

    `bend`, 0..1: 0 is a pinhole, 1/2 a stereographic, 1 an equidistant fisheye.
    """

    bend: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.bend <= 1.0:
            raise InputError(f"bend of a fisheye must lie in 0..1, got {self.bend}")

    def distort(self, points: Float64) -> Float64:
        """(..., 2) where the lens shows the pinhole's points (..., 2)."""
        r = np.linalg.norm(points, axis=-1)
        theta, left = np.arctan(r), 1.0 - self.bend
        seen = np.tan(left * theta) / left if left > 1e-6 else theta
        return np.asarray(points * np.where(r > 1e-12, seen / np.maximum(r, 1e-12), 1.0)[..., None])

    def undistort(self, points: Float64) -> Float64:
        """(..., 2) the pinhole's points that are seen at (..., 2); NaN at 90 degrees from the axis and beyond."""
        seen = np.linalg.norm(points, axis=-1)
        left = 1.0 - self.bend
        theta = np.arctan(left * seen) / left if left > 1e-6 else seen
        front = theta < 0.5 * np.pi - 1e-6
        r = np.tan(np.where(front, theta, 0.0))
        ratio = np.where(seen > 1e-12, r / np.maximum(seen, 1e-12), 1.0)
        return np.asarray(np.where(front[..., None], points * ratio[..., None], np.nan))
