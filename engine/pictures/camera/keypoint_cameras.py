"""Cameras that the keypoints of a picture and the landmarks of a model agree on (DESIGN 4.8)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.model import Bool, Camera, Float32, Float64, GaussianModel, Int64
from engine.numerics.resampling import resized
from engine.pictures.camera.camera_motion import CENTERED, PARAMETERS
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.pixel_shape import SQUARE, PixelShape
from engine.pictures.camera.pose_ransac import Hypothesis, at_other_focal, fit_camera, hypothesize
from engine.pictures.camera.visible_window import Window
from engine.pictures.landmarks.keypoints import Keypoints, detect_keypoints
from engine.pictures.landmarks.landmark_matching import match_landmarks, match_projected
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.pictures.landmarks.rendered_landmarks import make_landmarks

__all__ = ["MatchedKeypoints", "NearRender", "keypoints_of", "match_closer", "match_near"]

_CONFIG = CONFIG.keypoints


@dataclass(frozen=True, eq=False)
class MatchedKeypoints:
    """Keypoints of a picture, and the landmarks (indices) they may show: few, mostly right, then many, mostly wrong."""

    keypoints: Keypoints
    landmarks: Landmarks
    size: tuple[int, int]  # width and height of the picture
    matches: Sequence[tuple[Int64, Int64]]

    @classmethod
    def of(cls, keypoints: Keypoints, landmarks: Landmarks, size: tuple[int, int]) -> MatchedKeypoints:
        """What these keypoints match."""
        radius = _CONFIG.same_place * _radius(landmarks)
        matches = match_landmarks(keypoints, landmarks, _CONFIG.ratios, radius, _CONFIG.views)
        return cls(keypoints, landmarks, size, matches)

    @property
    def tolerance(self) -> float:
        """Reprojection error of an inlier, pixels."""
        return _CONFIG.tolerance * max(self.size)

    def hypotheses(self, focals: tuple[float, ...]) -> Iterator[Hypothesis]:
        """The camera that most keypoints agree with, from each set of matches; by falling support, except that one with
        enough comes before another is sought. The focal lengths tried are in widths of the picture."""
        found: list[Hypothesis] = []
        for pairs in self.matches:
            guided = self.agreed(*pairs, focals)
            if guided is not None and guided.support >= _CONFIG.enough:
                yield guided
            elif guided is not None:
                found.append(guided)
        yield from sorted(found, key=lambda hypothesis: -hypothesis.support)

    def agreed(self, keypoints: Int64, landmarks: Int64, focals: tuple[float, ...]) -> Hypothesis | None:
        """The camera that most of these pairs (indices) agree with, and then enough of all keypoints."""
        points = self.landmarks.points[landmarks].astype(np.float64)
        pixels = self.keypoints.points[keypoints]
        start = hypothesize(points, pixels, *self.size, self.tolerance, _CONFIG.least_start, focals)
        guided = None if start is None else self.guided(start.camera)
        return guided if guided is not None and guided.support >= _CONFIG.least_inliers else None

    def guided(self, camera: Camera, factors: tuple[float, ...] = _CONFIG.guided) -> Hypothesis | None:
        """A camera fitted to all that matches where it projects, which is more than stood out at first."""
        fitted = None
        for factor in factors:
            points, pixels = self.projected(camera, 3.0 * factor * self.tolerance)
            fitted = fit_camera(points, pixels, camera, factor * self.tolerance) if len(points) > 3 else None
            if fitted is None:
                return None
            camera = fitted.camera
        return None if fitted is None else self._off_center(fitted)

    def _off_center(self, centered: Hypothesis) -> Hypothesis:
        """The camera of a picture of which a part was cut off, where clearly more keypoints agree with that."""
        points, pixels = self.projected(centered.camera, 3.0 * self.tolerance)
        if len(points) < _CONFIG.least_off_center:
            return centered
        fixed, freed = (
            fit_camera(points, pixels, centered.camera, self.tolerance, free=count) for count in (CENTERED, PARAMETERS)
        )
        if fixed is None or freed is None:
            return centered
        gained = freed.support * fixed.rms >= _CONFIG.off_center_gain * fixed.support * freed.rms
        return freed if gained else centered

    def at_other_focals(self, hypothesis: Hypothesis, factors: Sequence[float]) -> Iterator[Hypothesis]:
        """Cameras of other focal lengths with which the keypoints agree about as well."""
        points, pixels = self.projected(hypothesis.camera, self.tolerance)
        for factor in factors:
            other = at_other_focal(points, pixels, hypothesis, factor, 0.5 * self.tolerance)
            if other is not None:
                yield other

    def projected(self, camera: Camera, radius: float, shape: PixelShape = SQUARE) -> tuple[Float64, Float64]:
        """Landmarks (M, 3) and the keypoints (M, 2) that look like them within so many pixels of their projections;
        `shape` is that of the picture's pixels."""
        square = self.keypoints
        if shape != SQUARE:
            square = Keypoints(shape.squared(square.points), square.descriptors)
        keypoint, landmark = match_projected(square, self.landmarks, camera, radius)
        return self.landmarks.points[landmark].astype(np.float64), self.keypoints.points[keypoint]


def match_closer(model: GaussianModel, gray: Float32, camera: Camera) -> Hypothesis | None:
    """The camera that a picture's brightness (H, W) and a render from nearly there agree on; None where too few
    keypoints do.

    Keypoints are detected where the render shows the model, and around: those of the background would outnumber them.
    Nothing is sought where the two, reduced, do not correlate.
    """
    found = None
    for factors in (_CONFIG.guided_far, _CONFIG.guided):  # the second from where the first ended: it is nearer
        near = match_near(model, gray, camera, _CONFIG.least_resemblance)
        if near is None:
            return found
        closer = near.matched.guided(near.camera, factors)
        if closer is None or closer.support < max(_CONFIG.least_inliers, 0 if found is None else found.support):
            return found
        camera = near.window.back(closer.camera)
        found = replace(closer, camera=camera)
    return found


@dataclass(frozen=True, eq=False)
class NearRender:
    """The part of a picture in which a camera sees the model, matched to a render from there."""

    matched: MatchedKeypoints
    camera: Camera  # of the part
    window: Window  # where the part lies


def match_near(model: GaussianModel, gray: Float32, camera: Camera, least: float = -1.0) -> NearRender | None:
    """The part of a picture's brightness (H, W) in which a camera sees the model, matched to a render from there; None
    where the camera does not see the model, or picture and render correlate by less than `least`."""
    window = Window.around(model, camera, gray)
    if window is None or window.resemblance < least:
        return None
    near = window.of(camera)
    part = resized(gray[window.rows, window.columns], near.width, near.height)
    bank = make_landmarks(model, [near.with_side(_CONFIG.closer_side)])
    seen = keypoints_of(part, window.shown, _CONFIG.closer_side)
    matched = MatchedKeypoints(seen, bank, (near.width, near.height), ())
    return NearRender(matched, near, window) if len(bank) else None


def keypoints_of(gray: Float32, shown: Bool | None = None, size: int = _CONFIG.detection_side) -> Keypoints:
    """Keypoints of a picture's brightness (H, W), 0..1, reduced to a longer side of `size` pixels where it is larger;
    `shown` (h, w) of any size allows them."""
    import cv2

    height, width = gray.shape
    shrink = min(1.0, size / max(height, width))
    small = resized(gray, max(1, round(width * shrink)), max(1, round(height * shrink)))
    mask = None
    if shown is not None:
        mask = cv2.resize(shown.astype(np.uint8), small.shape[::-1], interpolation=cv2.INTER_NEAREST)
    found = detect_keypoints(small, _CONFIG.count, mask)
    return Keypoints(found.points * (width / small.shape[1], height / small.shape[0]), found.descriptors)


def _radius(landmarks: Landmarks) -> float:
    """Median distance of the landmarks from their middle, scene units."""
    if len(landmarks) == 0:
        return 0.0
    points: Float64 = landmarks.points.astype(np.float64)
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))
