"""Least-squares similarity between two point sets, plain and robust."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.model import Float64


@dataclass(frozen=True, eq=False)
class Similarity:
    """x_target = scale * R @ x_source + t: a positive scale, a proper rotation (3, 3) and a translation (3,) in units
    of the target."""

    scale: float
    R: Float64
    t: Float64

    @classmethod
    def identity(cls) -> "Similarity":
        """The similarity that moves nothing."""
        return cls(1.0, np.eye(3), np.zeros(3))

    def apply(self, points: npt.NDArray[Any]) -> Float64:
        """Points (..., 3) moved, float64."""
        return points.astype(np.float64) @ (self.scale * self.R).T + self.t

    def inverse(self) -> "Similarity":
        """The similarity that undoes this one."""
        return Similarity(1.0 / self.scale, self.R.T.copy(), -(self.R.T @ self.t) / self.scale)


def umeyama(
    source: npt.NDArray[Any], target: npt.NDArray[Any], weights: npt.NDArray[Any] | None = None
) -> Similarity | None:
    """The similarity that takes `source` (n, 3) to `target` (n, 3) with least square error, weighted by `weights` (n,).

    None if the points are too few or lie on a line, so that the rotation is not determined. Umeyama, "Least-squares
    estimation of transformation parameters between two point patterns", PAMI 1991, equations 40 to 42.
    """
    a, b = source.astype(np.float64), target.astype(np.float64)
    w = np.ones(len(a)) if weights is None else weights.astype(np.float64)
    total = float(w.sum())
    if len(a) < 3 or not total > 0:
        return None
    w = w / total
    center_a, center_b = w @ a, w @ b
    da, db = a - center_a, b - center_b
    cross = (db * w[:, None]).T @ da
    u, singular, vt = np.linalg.svd(cross)
    # Rank 2 determines a proper rotation (three points do); rank 1, a line, does not.
    variance = float(w @ (da * da).sum(1))
    spread_b = float(w @ (db * db).sum(1))
    if not (variance > 0 and spread_b > 0) or singular[1] <= 1e-9 * np.sqrt(variance * spread_b):
        return None
    sign = np.array([1.0, 1.0, 1.0 if np.linalg.det(u @ vt) > 0 else -1.0])
    R = (u * sign) @ vt
    scale = float(singular @ sign) / variance
    if not (np.isfinite(scale) and scale > 0):
        return None
    return Similarity(scale, R, center_b - scale * R @ center_a)


def robust_umeyama(
    source: npt.NDArray[Any], target: npt.NDArray[Any], start: Similarity | None = None, rounds: int = 12
) -> Similarity | None:
    """As `umeyama`, but pairs far off the consensus lose their say (Tukey's biweight on the residuals, reweighted
    `rounds` times).

    At least half of the pairs are right, or close to `start`, which is the plain least-squares solution by default.
    """
    fit = umeyama(source, target) if start is None else start
    if fit is None:
        return None
    for turn in range(rounds):
        error = np.linalg.norm(fit.apply(source) - target, axis=1)
        # 4.685 standard deviations: 95 % efficiency for normal errors. The median of a 3-D normal error's
        # length is 1.538 standard deviations.
        cut = 4.685 * max(float(np.median(error)) / 1.538, 1e-12)
        weights = np.square(np.clip(1.0 - np.square(error / cut), 0.0, None))
        better = umeyama(source, target, weights)
        if better is None:
            return None if turn == 0 else fit
        moved = float(np.abs(better.t - fit.t).max()) + float(np.abs(better.R - fit.R).max()) * cut
        fit = better
        if moved < 1e-9 * cut:
            break
    return fit


def fit_noisy_source(
    source: npt.NDArray[Any], target: npt.NDArray[Any], start: Similarity | None = None
) -> Similarity | None:
    """As `robust_umeyama`, where the noise is in the source.

    Fitted the other way round and inverted: least squares with noise in the source shrinks the scale (by 1 % for noise
    of a tenth of the spread).
    """
    back = robust_umeyama(target, source, None if start is None else start.inverse())
    return None if back is None else back.inverse()
