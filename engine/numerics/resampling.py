"""Cubic resampling of images at exact positions.

OpenCV's warps round positions to 1/32 pixel; evidence for a mark needs the images in register to a few
hundredths of a pixel, so the interpolation is done here. Coordinates follow docs/CONVENTIONS.md: the centre
of pixel (column i, row j) is (i + 0.5, j + 0.5).
"""

# mypy: allow-untyped-defs

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.kernels.jit import inlined, kernel, parallel_kernel, share_of
from engine.model import Bool, Float32, Float64


@inlined
def _cubic(t):
    """Weights of the four neighbours at fraction t: Keys' kernel with a = -1/2 (Catmull-Rom)."""
    t2 = t * t
    t3 = t2 * t
    return (-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2)


@inlined
def _cubic_pixel(image, u, v, pixel):
    """Add to `pixel` (C,) the image at position u, v; False, and nothing added, outside the image."""
    height, width, channels = image.shape
    if not (u >= 0.0 and v >= 0.0 and u <= width and v <= height):
        return False
    u -= 0.5
    v -= 0.5
    iu, iv = int(np.floor(u)), int(np.floor(v))
    wx, wy = _cubic(u - iu), _cubic(v - iv)
    for a in range(4):
        row = min(max(iv - 1 + a, 0), height - 1)
        for b in range(4):
            column = min(max(iu - 1 + b, 0), width - 1)
            weight = wy[a] * wx[b]
            for c in range(channels):
                pixel[c] += np.float32(weight) * image[row, column, c]
    return True


@parallel_kernel
def _warp(image, m, out, inside, call):
    for j in share_of(out.shape[0], call):
        for i in range(out.shape[1]):
            x, y = i + 0.5, j + 0.5
            w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
            if not w > 1e-9:
                continue
            u = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w
            v = (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
            inside[j, i] = _cubic_pixel(image, u, v, out[j, i])


@parallel_kernel
def _remap(image, positions, out, inside, call):
    for j in share_of(out.shape[0], call):
        for i in range(out.shape[1]):
            inside[j, i] = _cubic_pixel(image, positions[j, i, 0], positions[j, i, 1], out[j, i])


@kernel
def _sample(image, points, out):
    height, width = image.shape
    for k in range(points.shape[0]):
        u, v = points[k, 0], points[k, 1]
        if not (u >= 0.0 and v >= 0.0 and u <= width and v <= height):
            out[k] = np.nan
            continue
        u -= 0.5
        v -= 0.5
        iu, iv = int(np.floor(u)), int(np.floor(v))
        wx, wy = _cubic(u - iu), _cubic(v - iv)
        total = 0.0
        for a in range(4):
            row = min(max(iv - 1 + a, 0), height - 1)
            for b in range(4):
                column = min(max(iu - 1 + b, 0), width - 1)
                total += wy[a] * wx[b] * image[row, column]
        out[k] = total


def warp(image: Float32, matrix: Float64, height: int, width: int) -> tuple[Float32, Bool]:
    """Resample an image (h, w, C) into another frame, cubic.

    `matrix` (3, 3) is the homography from pixel coordinates of the result to those of `image`. Returns the result
    (height, width, C), 0 where the position falls outside `image`, and where it lies inside (height, width).
    """
    out = np.zeros((height, width, image.shape[2]), dtype=np.float32)
    inside = np.zeros((height, width), dtype=np.bool_)
    _warp(np.ascontiguousarray(image), np.ascontiguousarray(matrix, dtype=np.float64), out, inside)
    return out, inside


def remap(image: Float32, positions: Float64) -> tuple[Float32, Bool]:
    """Resample an image (h, w, C) at any positions (height, width, 2) x, y in its pixels, NaN for nowhere; returns as
    `warp`."""
    height, width = positions.shape[:2]
    out = np.zeros((height, width, image.shape[2]), dtype=np.float32)
    inside = np.zeros((height, width), dtype=np.bool_)
    _remap(np.ascontiguousarray(image), np.ascontiguousarray(positions, dtype=np.float64), out, inside)
    return out, inside


def sample(image: Float32, points: Float64) -> Float32:
    """(P,) cubic samples of a grey (h, w) image at (P, 2) pixel coordinates x, y; NaN outside."""
    out = np.empty(len(points), dtype=np.float32)
    _sample(np.ascontiguousarray(image), np.ascontiguousarray(points, dtype=np.float64), out)
    return out


def map_points(matrix: Float64, points: npt.NDArray[Any]) -> Float64:
    """(P, 2) points under a homography; far outside every image (-1e9) where they lie behind its horizon."""
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    front = mapped[:, 2] > 1e-9
    safe = np.where(front, mapped[:, 2], 1.0)
    return np.asarray(np.where(front[:, None], mapped[:, :2] / safe[:, None], -1e9))


def smooth(image: Float32, sigma: float) -> Float32:
    """Gaussian blur of `sigma` pixels (0 is the identity), borders mirrored; (H, W) or (H, W, C)."""
    import cv2

    if sigma <= 0:
        return image
    blurred = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, dtype=np.float32).reshape(image.shape)


def resized(gray: Float32, width: int, height: int) -> Float32:
    """An image (H, W) at another size, reduced by areas."""
    import cv2

    if (height, width) == gray.shape:
        return gray
    return np.asarray(cv2.resize(gray, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)
