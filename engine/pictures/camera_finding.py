"""Find the camera of a screenshot of a known model: position, direction and focal length (DESIGN 4.8).

1. Keypoints of the picture, matched to the landmarks of the record.
2. PnP-RANSAC over a ladder of focal lengths; refined on the matches that agree.
3. Robust Gauss-Newton on brightness against fresh renders, coarse to fine, to about a hundredth of a pixel.
4. Where that is not sure, the same for the picture turned over left to right, if more of it matches. Turned over upside
   down is that and half a turn.

The picture of another scene fails at the number of agreeing matches, or at the correlation with the render.
Nothing here sees a key or a chip.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.errors import InputError
from engine.model import Camera, Float32, Float64, GaussianModel, Int64
from engine.pictures.camera_hypotheses import LADDER, Hypothesis, at_other_focal, fit_camera, hypothesize
from engine.pictures.features import Keypoints, detect_keypoints, luma
from engine.pictures.landmark_matching import match_landmarks, match_projected
from engine.pictures.landmarks import Landmarks
from engine.pictures.pose_refinement import refine_level

__all__ = ["CameraConfig", "FoundCamera", "find_camera"]

KEYPOINTS = 2000
"""SIFT keypoints of the picture."""
DETECTION_SIZE = 1000
"""Longer side of the picture keypoints are detected in, pixels; larger pictures are reduced."""
RATIOS = (0.8, 0.85)
"""Lowe's ratio of distances over the whole bank, and within each of its views. The first gives few matches, mostly
right; the second many, mostly wrong."""
VIEWS = 8
"""Views of the bank in which the second kind is sought: those with most matches."""
SAME_PLACE = 0.05
"""Landmarks nearer to each other than this are one place, in radii of the bank."""
TOLERANCE = 0.005
"""Reprojection error of an inlier, in longer sides of the picture."""
LEAST_START, LEAST_INLIERS = 6, 12
"""Matches that must agree before the camera is roughly known, and keypoints that must agree with it then."""
LEAST_CORRELATION = 0.75
"""Correlation of brightness with the render below which the picture shows something else."""
COARSE_SIZE, FINE_SIZE = 1000, 2000
"""Largest longer side of the first and of the last level of the refinement, pixels. Renders at another size than the
picture's are not quite the reduced picture, so there is no level coarser than needed."""
ITERATIONS = 12
"""Renders of one level at most."""
STEP = 0.005
"""The refinement ends when its step is smaller, pixels."""
GUIDED = (1.0, 1.0, 0.5)
"""Tolerances of the rounds of guided matching, in those of the first."""


@dataclass(frozen=True)
class CameraConfig:
    """How hard `find_camera` tries."""

    sure_correlation: float = 0.98
    """Correlation of brightness with the render above which a refinement that converged has not failed."""
    focals: tuple[float, ...] = LADDER
    """Focal lengths the pose from keypoints is sought at, in widths of the picture; it is refined after."""
    other_focals: tuple[float, ...] = (1.4, 0.75, 1.9)
    """Focal lengths to start from where the refinement from the keypoints' own fails, in those."""


@dataclass(frozen=True, eq=False)
class FoundCamera:
    """The camera of a picture."""

    camera: Camera  # of the picture's size; square pixels, principal point in the centre
    inliers: int  # matches that agree with the pose found from keypoints
    rms: float  # robust standard deviation of the brightness residual, 0..1
    correlation: float  # of picture and render, -1..1
    step: float  # root mean square flow of the last step of the refinement, pixels
    mirrored: bool = False  # it is the camera of the picture turned over left to right

    def face(self, image: Float32) -> Float32:
        """The picture (h, w, 3) as this camera sees it: turned over left to right if it was mirrored."""
        return np.ascontiguousarray(image[:, ::-1]) if self.mirrored else image


def find_camera(
    landmarks: Landmarks, reference_model: GaussianModel, image: Float32, config: CameraConfig = CameraConfig()
) -> FoundCamera | None:
    """Camera from which a picture (h, w, 3), 0..1, shows the unmarked reference; None when no view of it was
    recognised.

    `landmarks` are those of its record. InputError if the picture is not a finite (h, w, 3) image.
    """
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < 16:
        raise InputError(f"a picture is (h, w, 3) and at least 16 pixels a side, got {image.shape}")
    if not np.isfinite(image).all():
        raise InputError("the picture holds values that are not finite")
    grey = luma(np.asarray(image, dtype=np.float32))
    own = _Look.of(_keypoints(grey), landmarks)
    best = _search(landmarks, reference_model, grey, own, config)
    if best is not None and _is_sure(best, config):
        return best
    mirrored = _Look.of(own.keypoints.turned_over(grey.shape[1]), landmarks)
    if mirrored.support <= own.support:
        return best
    other = _search(landmarks, reference_model, np.ascontiguousarray(grey[:, ::-1]), mirrored, config)
    return _better(best, None if other is None else replace(other, mirrored=True))


@dataclass(frozen=True, eq=False)
class _Look:
    """Keypoints of a picture, and the landmarks (indices) they may show: few, mostly right, then many, mostly wrong."""

    keypoints: Keypoints
    matches: Sequence[tuple[Int64, Int64]]

    @property
    def support(self) -> int:
        return len(self.matches[0][0])

    @classmethod
    def of(cls, keypoints: Keypoints, landmarks: Landmarks) -> _Look:
        """What these keypoints match."""
        return cls(keypoints, match_landmarks(keypoints, landmarks, RATIOS, SAME_PLACE * _radius(landmarks), VIEWS))


def _keypoints(grey: Float32) -> Keypoints:
    height, width = grey.shape
    shrink = min(1.0, DETECTION_SIZE / max(height, width))
    small = _resized(grey, max(1, round(width * shrink)), max(1, round(height * shrink)))
    found = detect_keypoints(small, KEYPOINTS)
    enlarged = found.points * (width / small.shape[1], height / small.shape[0])
    return Keypoints(enlarged, found.descriptors)


def _search(
    landmarks: Landmarks, reference_model: GaussianModel, grey: Float32, look: _Look, config: CameraConfig
) -> FoundCamera | None:
    """The camera of a picture (h, w) as it is, or turned over."""
    height, width = grey.shape
    starts = _hypotheses(look.keypoints, landmarks, look.matches, (width, height), config.focals)
    best: FoundCamera | None = None
    for start in starts:
        best = _better(best, _refine(reference_model, grey, start))
        if best is not None and _is_sure(best, config):
            break
    if best is not None and not _is_sure(best, config):
        for start in _at_other_focals(look.keypoints, landmarks, max(starts, key=lambda h: h.support), config):
            best = _better(best, _refine(reference_model, grey, start))
            if best is not None and _is_sure(best, config):
                break
    return best


def _better(first: FoundCamera | None, second: FoundCamera | None) -> FoundCamera | None:
    if first is None or second is None:
        return first or second
    return second if second.correlation > first.correlation else first


def _is_sure(found: FoundCamera, config: CameraConfig) -> bool:
    return found.step < STEP and found.correlation > config.sure_correlation


def _hypotheses(
    keypoints: Keypoints,
    landmarks: Landmarks,
    matches: Sequence[tuple[Int64, Int64]],
    size: tuple[int, int],
    focals: tuple[float, ...],
) -> list[Hypothesis]:
    """The camera that most keypoints agree with, from each set of matches; by falling support."""
    tolerance = TOLERANCE * max(size)
    found = []
    for keypoint, landmark in matches:
        points, pixels = landmarks.points[landmark].astype(np.float64), keypoints.points[keypoint]
        start = hypothesize(points, pixels, *size, tolerance, LEAST_START, focals)
        guided = None if start is None else _guided(keypoints, landmarks, start, tolerance)
        if guided is not None and guided.support >= LEAST_INLIERS:
            found.append(guided)
    return sorted(found, key=lambda hypothesis: -hypothesis.support)


def _guided(keypoints: Keypoints, landmarks: Landmarks, hypothesis: Hypothesis, tolerance: float) -> Hypothesis | None:
    """A hypothesis fitted to all that matches where it projects, which is more than stood out at first."""
    for factor in GUIDED:
        keypoint, landmark = match_projected(keypoints, landmarks, hypothesis.camera, 3.0 * factor * tolerance)
        points, pixels = landmarks.points[landmark].astype(np.float64), keypoints.points[keypoint]
        fitted = fit_camera(points, pixels, hypothesis.camera, factor * tolerance)
        if fitted is None:
            return None
        hypothesis = fitted
    return hypothesis


def _at_other_focals(
    keypoints: Keypoints, landmarks: Landmarks, hypothesis: Hypothesis, config: CameraConfig
) -> Iterator[Hypothesis]:
    """Cameras of other focal lengths with which the keypoints agree about as well."""
    tolerance = TOLERANCE * max(hypothesis.camera.width, hypothesis.camera.height)
    keypoint, landmark = match_projected(keypoints, landmarks, hypothesis.camera, tolerance)
    points, pixels = landmarks.points[landmark].astype(np.float64), keypoints.points[keypoint]
    for factor in config.other_focals:
        other = at_other_focal(points, pixels, hypothesis, factor, 0.5 * tolerance)
        if other is not None:
            yield other


def _refine(model: GaussianModel, grey: Float32, hypothesis: Hypothesis) -> FoundCamera | None:
    """Refine on brightness, coarse to fine; None when a level does not look like the picture."""
    camera = hypothesis.camera
    height, width = grey.shape
    largest = min(max(width, height), FINE_SIZE)
    size = min(COARSE_SIZE, largest)
    while True:
        shrink = size / max(width, height)
        shape = max(16, round(width * shrink)), max(16, round(height * shrink))
        refined = refine_level(model, _resized(grey, *shape), camera.resized(*shape), ITERATIONS, STEP)
        if refined is None or refined.correlation < LEAST_CORRELATION:
            return None
        camera = _square(refined.camera.resized(width, height))
        if size == largest:
            return FoundCamera(camera, hypothesis.support, refined.rms, refined.correlation, refined.step)
        size = min(2 * size, largest)


def _square(camera: Camera) -> Camera:
    """Square pixels and a central principal point, which rounding of a level's size may have bent."""
    focal = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    K = np.array([[focal, 0.0, camera.width / 2], [0.0, focal, camera.height / 2], [0.0, 0.0, 1.0]])
    return Camera(camera.viewmat, K, camera.width, camera.height)


def _resized(grey: Float32, width: int, height: int) -> Float32:
    import cv2

    if (height, width) == grey.shape:
        return grey
    return np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)


def _radius(landmarks: Landmarks) -> float:
    """Median distance of the landmarks from their middle, scene units."""
    if len(landmarks) == 0:
        return 0.0
    points: Float64 = landmarks.points.astype(np.float64)
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))
