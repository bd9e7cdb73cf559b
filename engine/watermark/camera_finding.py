"""Find the camera of a picture that nobody knows anything about (DESIGN 4.8).

1. SIFT on the picture, matched with the landmarks view by view; the views with most matches vote.
2. P3P + RANSAC over a ladder of focal lengths, then a robust fit of pose and focal length to the points.
3. Guided matching: all landmarks projected, matched only with what lies near; the fit again.
4. Robust Gauss-Newton on brightness against fresh renders (`pose_refinement`).

Nothing here sees a key or a chip.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from engine.errors import InputError
from engine.model import Camera, Float32, Float64, GaussianModel, Int64
from engine.watermark.features import Keypoints, detect_keypoints, luma, match_within
from engine.watermark.landmarks import Landmarks
from engine.watermark.pose import FREE_ALL, FREE_CENTERED, fit_pose, project, unit_camera
from engine.watermark.pose_refinement import RefinementConfig, refine_pose

__all__ = ["CameraFindingConfig", "FoundCamera", "find_camera"]


@dataclass(frozen=True)
class CameraFindingConfig:
    """Knobs of `find_camera`.

    Parameters
    ----------
    keypoints : int
        SIFT keypoints of the picture.
    longest_side : int
        Pictures are reduced to this for keypoints, pixels.
    ratio : float
        Lowe's ratio of distances within a view.
    views : int
        Views whose matches are used, those with most.
    focal_low, focal_high : float
        Range of focal lengths tried, in units of the longer side.
    focal_steps : int
    ransac_rounds : int
        Hypotheses for each focal length.
    ransac_share : float
        Reprojection error of an inlier in the ladder, as a share of the longer side: it must hide the step
        between two focal lengths.
    inlier_share : float
        Reprojection error of an inlier of the fitted camera.
    least_inliers : int
        Fewer distinct inliers are no camera.
    least_correlation : float
        Correlation with the final render below which there is no camera.
    refinement : RefinementConfig
    """

    keypoints: int = 2500
    longest_side: int = 1000
    ratio: float = 0.8
    views: int = 10
    focal_low: float = 0.45
    focal_high: float = 2.4
    focal_steps: int = 13
    ransac_rounds: int = 600
    ransac_share: float = 0.012
    inlier_share: float = 0.005
    least_inliers: int = 12
    least_correlation: float = 0.5
    refinement: RefinementConfig = field(default_factory=RefinementConfig)


@dataclass(frozen=True, eq=False)
class FoundCamera:
    """A camera that explains a picture.

    Parameters
    ----------
    camera : Camera
        At the picture's size.
    inliers : int
        Keypoints that agree with it.
    rms : float
        Robust residual of brightness against the final render, image units.
    correlation : float
        Of brightness with the final render, -1..1.
    seconds_by_stage : dict
        Keypoints, matching, pose, refinement.
    """

    camera: Camera
    inliers: int
    rms: float
    correlation: float
    seconds_by_stage: dict[str, float]


def find_camera(
    landmarks: Landmarks,
    reference_model: GaussianModel,
    image: Float32,
    config: CameraFindingConfig = CameraFindingConfig(),
) -> FoundCamera | None:
    """Find where a picture was taken from.

    Parameters
    ----------
    landmarks : Landmarks
        Of the reference.
    reference_model : GaussianModel
        The unmarked reference.
    image : (h, w, 3) float32
        The picture, 0..1.
    config : CameraFindingConfig

    Returns
    -------
    FoundCamera or None
        None when the picture shows nothing of this model that can be recognised.

    Raises
    ------
    InputError
        If the image is not (h, w, 3).
    """
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < 16:
        raise InputError(f"expected an image (h, w, 3) of at least 16x16, got shape {image.shape}")
    seconds: dict[str, float] = {}
    clock = _Laps(seconds)
    height, width = image.shape[:2]
    keypoints = _keypoints(image, config)
    clock.lap("keypoints")
    near, far = _match(landmarks, keypoints, config)
    clock.lap("matching")
    camera = _search(landmarks.points[far].astype(np.float64), keypoints.points[near], width, height, config)
    if camera is None:
        return None
    camera, inliers = _guided(camera, landmarks, keypoints, config)
    clock.lap("pose")
    if inliers < config.least_inliers:
        return None
    fit = refine_pose(reference_model, image, camera, config.refinement)
    clock.lap("refinement")
    if fit is None or fit.correlation < config.least_correlation:
        return None
    return FoundCamera(fit.camera, inliers, fit.rms, fit.correlation, seconds)


class _Laps:
    def __init__(self, seconds: dict[str, float]) -> None:
        self.seconds, self.last = seconds, time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name], self.last = now - self.last, now


def _keypoints(image: Float32, config: CameraFindingConfig) -> Keypoints:
    import cv2

    height, width = image.shape[:2]
    grey, shrink = luma(image), config.longest_side / max(height, width)
    if shrink < 1.0:
        size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    found = detect_keypoints(grey, config.keypoints)
    return Keypoints(found.points * [width / grey.shape[1], height / grey.shape[0]], found.descriptors)


def _match(landmarks: Landmarks, keypoints: Keypoints, config: CameraFindingConfig) -> tuple[Int64, Int64]:
    """Keypoint and landmark indices of the matches in the views that have most of them.

    The ratio test runs within a view: the same point seen in its neighbours is no competitor.
    """
    matches = []
    starts = np.flatnonzero(np.diff(landmarks.views, prepend=-1))
    for low, high in zip(starts, [*starts[1:], len(landmarks)], strict=True):
        near, far = match_within(keypoints.descriptors, landmarks.descriptors[low:high], config.ratio)
        matches.append((near, far + low))
    matches.sort(key=lambda pair: -len(pair[0]))  # stable: ties keep the bank's order
    best = matches[: config.views] or [(np.zeros(0, np.int64), np.zeros(0, np.int64))]
    return np.concatenate([m[0] for m in best]), np.concatenate([m[1] for m in best])


def _search(
    points: Float64, pixels: Float64, width: int, height: int, config: CameraFindingConfig
) -> Camera | None:
    """The camera that most matches agree with, over the ladder of focal lengths."""
    import cv2

    if len(points) < config.least_inliers // 2:
        return None
    side = max(width, height)
    candidates = []
    for focal in np.geomspace(config.focal_low, config.focal_high, config.focal_steps) * side:
        camera = unit_camera(np.eye(3), np.zeros(3), float(focal), width, height)
        cv2.setRNGSeed(0)
        try:
            found, turn, shift, inliers = cv2.solvePnPRansac(
                points, pixels, camera.K, None, iterationsCount=config.ransac_rounds,
                reprojectionError=config.ransac_share * side, confidence=0.9999, flags=cv2.SOLVEPNP_AP3P,
            )  # fmt: skip
        except cv2.error:  # degenerate points, all in one place
            continue
        if not found or inliers is None:
            continue
        rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
        camera = unit_camera(
            rotation, np.asarray(shift, dtype=np.float64).ravel(), float(focal), width, height
        )
        candidates.append((_agreement(camera, points, pixels, config.ransac_share * side)[0], camera))
    if not candidates:
        return None
    candidates.sort(key=lambda pair: -pair[0])
    fitted = []
    for _, camera in candidates[:4]:
        inlying = _agreement(camera, points, pixels, 2.0 * config.ransac_share * side)[1]
        camera = fit_pose(
            camera,
            points[inlying],
            pixels[inlying],
            free=FREE_CENTERED,
            loss_pixels=config.inlier_share * side,
        )
        fitted.append((_agreement(camera, points, pixels, config.inlier_share * side)[0], camera))
    return max(fitted, key=lambda pair: pair[0])[1]


def _agreement(camera: Camera, points: Float64, pixels: Float64, limit: float) -> tuple[int, Int64]:
    """Number of distinct keypoints within `limit` pixels of their landmark, and the matches among them."""
    error = np.linalg.norm(project(camera, points)[0] - pixels, axis=1)
    inlying = np.nonzero(error < limit)[0]
    return len(np.unique(pixels[inlying], axis=0)), inlying


def _guided(
    camera: Camera, landmarks: Landmarks, keypoints: Keypoints, config: CameraFindingConfig
) -> tuple[Camera, int]:
    """Match again with the camera known, from all views, and fit; the principal point only if that explains more."""
    side = max(camera.width, camera.height)
    limit = config.inlier_share * side
    points = landmarks.points.astype(np.float64)
    for _ in range(2):
        near, far = _match_near(camera, landmarks, keypoints, 3.0 * limit)
        if len(near) < config.least_inliers:
            break
        camera = fit_pose(
            camera, points[far], keypoints.points[near], free=FREE_CENTERED, loss_pixels=0.5 * limit
        )
    near, far = _match_near(camera, landmarks, keypoints, 3.0 * limit)
    if not len(near):
        return camera, 0
    seen = keypoints.points[near]
    count = _agreement(camera, points[far], seen, 0.5 * limit)[0]
    cropped = fit_pose(camera, points[far], seen, free=FREE_ALL, loss_pixels=0.5 * limit)
    near, far = _match_near(cropped, landmarks, keypoints, 3.0 * limit)
    more = _agreement(cropped, points[far], keypoints.points[near], 0.5 * limit)[0] if len(near) else 0
    return (cropped, more) if more > 1.15 * count + 5 else (camera, count)


def _match_near(
    camera: Camera, landmarks: Landmarks, keypoints: Keypoints, radius: float
) -> tuple[Int64, Int64]:
    """For each keypoint the landmark that looks most like it among those projected within `radius` pixels."""
    from scipy.spatial import cKDTree

    pixels, _ = project(camera, landmarks.points.astype(np.float64))
    size = np.array([camera.width, camera.height])
    visible = np.nonzero(((pixels >= 0) & (pixels < size)).all(axis=1))[0]
    empty = np.zeros(0, dtype=np.int64)
    if not len(visible) or not len(keypoints):
        return empty, empty
    lists = cKDTree(pixels[visible]).query_ball_point(keypoints.points, radius)
    counts = np.array([len(found) for found in lists])
    if not counts.sum():
        return empty, empty
    near = np.repeat(np.arange(len(keypoints)), counts)
    far = visible[np.concatenate([np.asarray(found, dtype=np.int64) for found in lists])]
    difference = keypoints.descriptors[near].astype(np.float32) - landmarks.descriptors[far]
    distance = np.einsum("ij,ij->i", difference, difference)
    order = np.lexsort((far, distance, near))
    first = order[np.unique(near[order], return_index=True)[1]]
    # Within a few pixels there is little choice, so alike must be really alike: RootSIFT has length 512.
    first = first[distance[first] < (0.55 * 512.0) ** 2]
    return near[first].astype(np.int64), far[first].astype(np.int64)
