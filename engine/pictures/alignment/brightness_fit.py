"""Robust Gauss-Newton fit of a plane motion to the brightness of two images, coarse to fine."""

from dataclasses import dataclass

import numpy as np

from engine.model import Float32, Float64
from engine.numerics.resampling import map_points, sample, smooth
from engine.pictures.alignment.config import CONFIG

_CONFIG = CONFIG.planar


@dataclass(frozen=True, eq=False)
class Fit:
    """Motion and brightness of a suspect over a reference: suspect(matrix x) = gain reference(x) + offset.

    `inliers`: samples within 2.5 robust standard deviations; `rms`: that deviation, image units; `correlation` of both
    images on the samples.
    """

    matrix: Float64
    gain: float
    offset: float
    inliers: int
    rms: float
    correlation: float


def robust_scale(residual: Float32 | Float64) -> float:
    """Standard deviation estimated from the median absolute value, never below 1e-4."""
    return max(1.4826 * float(np.median(np.abs(residual))), 1e-4)


def fit_warp(
    reference: Float32, suspect: Float32, matrix: Float64, levels: tuple[int, ...], *, homography: bool
) -> Fit | None:
    """Refine a motion (3, 3) from reference to suspect pixel coordinates on the brightness, 0..1, of both.

    `levels` are reduction factors, coarsest first, among 8, 4, 2, 1; `homography` takes eight parameters in place of a
    similarity's four. None when the images do not overlap enough to say anything.
    """
    fit: Fit | None = None
    for level in levels:
        step = _fit_level(reference, suspect, matrix, level, homography)
        if step is not None:
            fit, matrix = step, step.matrix
    return fit


def _fit_level(reference: Float32, suspect: Float32, matrix: Float64, level: int, homography: bool) -> Fit | None:
    scale = float(np.sqrt(abs(np.linalg.det(matrix[:2, :2]))))
    if not 0.02 < scale < 50.0 or min(reference.shape) < 4 * level or min(suspect.shape) < 8:
        return None
    # Both images at the resolution of the coarser of the two, times the level's.
    width = 0.7 * level
    blurred = smooth(reference, width * max(1.0, 1.0 / scale))
    other = smooth(suspect, width * max(scale, 1.0))
    points, values, columns = _steepest(blurred, level, homography)
    if len(points) < _CONFIG.least_samples:
        return None
    gain, offset, best = 1.0, 0.0, None
    center = np.array([[reference.shape[1] / 2, reference.shape[0] / 2]])
    unit = max(reference.shape) / 2.0
    for iteration in range(_CONFIG.iterations[level.bit_length() - 1]):
        seen = sample(other, map_points(matrix, points))
        usable = np.isfinite(seen) & (seen < _CONFIG.clipped)
        if usable.sum() < max(_CONFIG.least_samples, 0.03 * len(points)):
            return None
        w, r, design = seen[usable], values[usable], columns[usable]
        if iteration == 0:
            gain, offset = robust_line(r, w)
        residual = w - gain * r - offset
        spread = robust_scale(residual)
        weight = 1.0 / (1.0 + np.square(residual / (2.5 * spread)))
        jacobian = np.concatenate([gain * design, r[:, None], np.ones_like(r)[:, None]], axis=1)  # (P, 6 or 10)
        weighted = jacobian * weight[:, None]
        normal = (weighted.T @ jacobian).astype(np.float64)
        normal[np.diag_indices_from(normal)] *= 1.0 + 1e-6
        normal[np.diag_indices_from(normal)] += 1e-9
        delta = np.linalg.solve(normal, (weighted.T @ residual).astype(np.float64))
        matrix = matrix @ np.linalg.inv(_motion(delta[:-2], center[0], unit))
        matrix = matrix / matrix[2, 2]
        gain, offset = gain + float(delta[-2]), offset + float(delta[-1])
        best = (residual, spread, r, w)
        if np.abs(delta[:-2]).max() * unit < 0.003 * level:
            break
        if not np.isfinite(matrix).all():
            return None
    assert best is not None
    residual, spread, r, w = best
    inlying = np.abs(residual) < 2.5 * spread
    both = np.std(r) * np.std(w)
    correlation = float(np.mean((r - r.mean()) * (w - w.mean())) / both) if both > 1e-12 else 0.0
    return Fit(matrix, gain, offset, int(inlying.sum()), spread, correlation)


def still_rms(reference: Float32, suspect: Float32, fit: Fit) -> float:
    """Robust residual, image units, of a fit of two images of one size (H, W) whose motion is left out."""
    points, values, _ = _steepest(smooth(reference, 0.7), 1, False)
    seen = sample(smooth(suspect, 0.7), points)
    usable = np.isfinite(seen) & (seen < _CONFIG.clipped)
    return robust_scale(seen[usable] - fit.gain * values[usable] - fit.offset) if usable.any() else np.inf


def robust_line(r: Float32, w: Float32) -> tuple[float, float]:
    """Gain and offset from quantiles: right for more than half the samples being right, and out of register."""
    low_r, high_r = np.quantile(r, [0.2, 0.8])
    low_w, high_w = np.quantile(w, [0.2, 0.8])
    gain = float(np.clip((high_w - low_w) / max(high_r - low_r, 1e-3), 0.2, 3.0))
    return gain, float(np.median(w) - gain * np.median(r))


def _steepest(image: Float32, level: int, homography: bool) -> tuple[Float64, Float32, Float32]:
    """Points (P, 2), brightness (P,) and motion columns (P, 4 or 8) of the steepest pixels."""
    gy, gx = np.gradient(image)
    gray = image[::level, ::level]
    gy, gx = np.asarray(gy)[::level, ::level], np.asarray(gx)[::level, ::level]
    energy = (gx * gx + gy * gy).ravel()
    chosen = np.nonzero(energy > max(1e-8, float(np.quantile(energy, max(0.5, 1 - _CONFIG.samples / energy.size)))))[0]
    rows, cols = np.divmod(chosen, gray.shape[1])
    points = np.stack([cols, rows], axis=1) * float(level) + 0.5  # (P, 2)
    unit = max(image.shape) / 2.0
    u = ((points[:, 0] - image.shape[1] / 2) / unit).astype(np.float32)
    v = ((points[:, 1] - image.shape[0] / 2) / unit).astype(np.float32)
    gx, gy = gx.ravel()[chosen] * unit, gy.ravel()[chosen] * unit
    if homography:
        radial = gx * u + gy * v
        columns = [gx * u, gx * v, gx, gy * u, gy * v, gy, -radial * u, -radial * v]
    else:
        columns = [gx * u + gy * v, gy * u - gx * v, gx, gy]
    return points, gray.ravel()[chosen], np.stack(columns, axis=1).astype(np.float32)


def _motion(delta: Float64, center: Float64, unit: float) -> Float64:
    """(3, 3) motion in pixels of a parameter step in units of `unit` about `center`."""
    if len(delta) == 8:
        a, b, c, d, e, f, g, h = delta
        step = np.array([[1 + a, b, c], [d, 1 + e, f], [g, h, 1.0]])
    else:
        a, b, c, f = delta
        step = np.array([[1 + a, -b, c], [b, 1 + a, f], [0.0, 0.0, 1.0]])
    to_unit = np.array([[1 / unit, 0, -center[0] / unit], [0, 1 / unit, -center[1] / unit], [0, 0, 1.0]])
    return np.asarray(np.linalg.inv(to_unit) @ step @ to_unit)
