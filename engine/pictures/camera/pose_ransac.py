"""From matches of a picture with places in the world to a camera: PnP-RANSAC over a ladder of focal lengths.

Three matches give a pose for a known focal length; the right step of the ladder is near enough for most
matches to agree, and Levenberg-Marquardt over pose and focal length closes the rest.
"""

from dataclasses import dataclass

import numpy as np

from engine.kernels.jit import side_by_side
from engine.model import Bool, Camera, Float64
from engine.pictures.camera.camera_motion import CENTERED, PARAMETERS, moved, normalized, point_columns
from engine.pictures.camera.config import CONFIG

POSE = 6
"""Parameters of a motion without zoom."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A camera, which of the M matches agree with it, and the reprojection error of these, pixels."""

    camera: Camera
    inliers: Bool
    rms: float

    @property
    def support(self) -> int:
        """Number of inliers."""
        return int(self.inliers.sum())


def hypothesize(
    points: Float64,
    pixels: Float64,
    width: int,
    height: int,
    tolerance: float,
    least: int,
    ladder: tuple[float, ...] = CONFIG.focals,
) -> Hypothesis | None:
    """Camera with square pixels and a central principal point that most matches agree with, at least `least`; None if
    there is none.

    `points` (M, 3) lie in the world, `pixels` (M, 2) in the picture, centres at half integers; `tolerance` is the
    reprojection error of an inlier, pixels; the `ladder` of focal lengths tried is in widths of the picture.
    """
    if len(points) < max(least, 5):
        return None
    # On the ladder's coarse steps even right matches miss by some pixels.
    tried = side_by_side(lambda step: _pose(points, pixels, step * width, width, height, 2.0 * tolerance), ladder)
    started = sorted((each for each in tried if each is not None and each[0] >= least), key=lambda each: -each[0])
    best: Hypothesis | None = None
    for _, camera in started[:3]:
        fitted = fit_camera(points, pixels, camera, tolerance)
        if fitted is not None and (best is None or fitted.support > best.support):
            best = fitted
    return best if best is not None and best.support >= least else None


def _pose(
    points: Float64, pixels: Float64, focal: float, width: int, height: int, tolerance: float
) -> tuple[int, Camera] | None:
    """The camera of this focal length, pixels, that most matches agree with, and how many do."""
    import cv2

    K = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    how = cv2.UsacParams()  # it looks at few points of a wrong camera: three times as quick, and finds more
    how.sampler, how.score = cv2.SAMPLING_UNIFORM, cv2.SCORE_METHOD_MSAC
    how.loMethod, how.randomGeneratorState = cv2.LOCAL_OPTIM_NULL, 0
    how.maxIterations, how.threshold, how.confidence = CONFIG.keypoints.ransac_trials, tolerance, 0.9999
    try:
        ok, _, turn, shift, agreeing = cv2.solvePnPRansac(points, pixels, K.copy(), None, params=how)
    except cv2.error:  # degenerate points
        return None
    if not ok or agreeing is None:
        return None
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    return (len(agreeing), Camera(viewmat, K, width, height)) if np.isfinite(viewmat).all() else None


def fit_camera(
    points: Float64, pixels: Float64, camera: Camera, tolerance: float, *, free: int = CENTERED
) -> Hypothesis | None:
    """Refine a camera by robust Levenberg-Marquardt over so many parameters of a motion, by default pose and focal
    length, on points (M, 3) and pixels (M, 2).

    Errors far above `tolerance`, an inlier's in pixels, lose their weight. None when every point ends up behind the
    camera.
    """
    damping = 1e-3
    cost, error, columns, weight = _linearize(points, pixels, camera, tolerance)
    for _ in range(30):
        columns = columns[..., :free]
        weighted = columns * weight[:, None, None]
        normal = np.einsum("mik,mil->kl", weighted, columns)
        right = np.einsum("mik,mi->k", weighted, error)
        normal[np.diag_indices_from(normal)] *= 1.0 + damping
        normal[np.diag_indices_from(normal)] += 1e-9
        step = np.linalg.solve(normal, right)
        if not np.isfinite(step).all() or np.abs(step).max() > 1.0:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        step = np.append(step, np.zeros(PARAMETERS - free))
        trial = moved(camera, step, _median_depth(points, camera))
        tried = _linearize(points, pixels, trial, tolerance)
        if tried[0] < cost:
            done = cost - tried[0] < 1e-6 * cost
            camera, damping = trial, max(damping / 10.0, 1e-9)
            cost, error, columns, weight = tried
            if done:
                break
        else:
            damping *= 10.0
            if damping > 1e6:
                break
    distance = np.linalg.norm(error, axis=1)
    inliers = distance < tolerance
    if not inliers.any():
        return None
    return Hypothesis(camera, inliers, float(np.sqrt(np.mean(distance[inliers] ** 2))))


def at_other_focal(
    points: Float64, pixels: Float64, start: Hypothesis, factor: float, tolerance: float
) -> Hypothesis | None:
    """The camera further away behind a longer lens (or nearer, shorter) that agrees with the same matches.

    From afar, or before something flat, the two look alike to within the error of the matches.
    """
    depth = _median_depth(points, start.camera)
    motion = np.zeros(PARAMETERS)
    motion[5], motion[6] = factor - 1.0, np.log(factor)
    return fit_camera(points, pixels, moved(start.camera, motion, depth), tolerance, free=POSE)


def _median_depth(points: Float64, camera: Camera) -> float:
    depth = points @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    front = depth[depth > 0]
    return float(np.median(front)) if len(front) else 1.0


def _linearize(
    points: Float64, pixels: Float64, camera: Camera, tolerance: float
) -> tuple[float, Float64, Float64, Float64]:
    """Cauchy cost, errors (M, 2), columns (M, 2, 11), weights (M,); points behind the camera weigh nothing."""
    rays, depth = normalized(points, camera)
    front = depth > 1e-9
    depth = np.where(front, depth, 1.0)
    rays = np.where(front[:, None], rays, 0.0)
    shown = rays @ camera.K[:2, :2].T + camera.K[:2, 2]
    error = np.where(front[:, None], pixels - shown, 1e3 * tolerance)
    distance = np.sum(error**2, axis=1) / tolerance**2
    weight = np.where(front, 1.0 / (1.0 + distance), 0.0)
    columns = point_columns(rays, depth / _median_depth(points, camera), camera.K)
    return float(np.log1p(distance).sum()), error, columns, weight
