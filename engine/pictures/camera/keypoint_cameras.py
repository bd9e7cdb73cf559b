"""Cameras that the keypoints of a picture and the landmarks of a model agree on (DESIGN 4.8)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.model import Bool, Camera, Float32, Float64, GaussianModel, Int64
from engine.numerics.resampling import resized
from engine.pictures.camera.camera_motion import CENTERED, PARAMETERS
from engine.pictures.camera.pixel_shape import SQUARE, PixelShape
from engine.pictures.camera.pose_ransac import Hypothesis, at_other_focal, fit_camera, hypothesize
from engine.pictures.camera.visible_window import CLOSER_SIZE, Window
from engine.pictures.landmarks.keypoints import Keypoints, detect_keypoints
from engine.pictures.landmarks.landmark_matching import match_landmarks, match_projected
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.pictures.landmarks.rendered_landmarks import make_landmarks

__all__ = ["Look", "keypoints_of", "look_closer", "look_near"]

LEAST_RESEMBLANCE = 0.15
"""Of a picture and the render from a view nearby, at a glance: of 52 looks that found enough keypoints two had less, of
425 others a half."""
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
ENOUGH = 60
"""Keypoints that agree on a camera, for which no other is sought before that one is tried."""
LEAST_START, LEAST_INLIERS = 6, 12
"""Matches that must agree before the camera is roughly known, and keypoints that must agree with it then."""
GUIDED, GUIDED_FAR = (1.0, 1.0, 0.5), (4.0, 2.0, 1.0, 0.5)
"""Tolerances of the rounds of guided matching, in that of an inlier: from matches, and from a view that looks alike."""
LEAST_OFF_CENTER, OFF_CENTER = 24, 1.1
"""Matches that can tell where a picture's own centre was, and how much better they must then agree (how many by their
error): of pictures that were not cropped it is 0.99 to 1.02, of others mostly above 1.1."""


@dataclass(frozen=True, eq=False)
class Look:
    """Keypoints of a picture, and the landmarks (indices) they may show: few, mostly right, then many, mostly wrong."""

    keypoints: Keypoints
    landmarks: Landmarks
    size: tuple[int, int]  # width and height of the picture
    matches: Sequence[tuple[Int64, Int64]]

    @classmethod
    def of(cls, keypoints: Keypoints, landmarks: Landmarks, size: tuple[int, int]) -> Look:
        """What these keypoints match."""
        radius = SAME_PLACE * _radius(landmarks)
        return cls(keypoints, landmarks, size, match_landmarks(keypoints, landmarks, RATIOS, radius, VIEWS))

    @property
    def tolerance(self) -> float:
        """Reprojection error of an inlier, pixels."""
        return TOLERANCE * max(self.size)

    def hypotheses(self, focals: tuple[float, ...]) -> Iterator[Hypothesis]:
        """The camera that most keypoints agree with, from each set of matches; by falling support, except that one with
        enough comes before another is sought. The focal lengths tried are in widths of the picture."""
        found: list[Hypothesis] = []
        for pairs in self.matches:
            guided = self.agreed(*pairs, focals)
            if guided is not None and guided.support >= ENOUGH:
                yield guided
            elif guided is not None:
                found.append(guided)
        yield from sorted(found, key=lambda hypothesis: -hypothesis.support)

    def agreed(self, keypoints: Int64, landmarks: Int64, focals: tuple[float, ...]) -> Hypothesis | None:
        """The camera that most of these pairs (indices) agree with, and then enough of all keypoints."""
        points = self.landmarks.points[landmarks].astype(np.float64)
        pixels = self.keypoints.points[keypoints]
        start = hypothesize(points, pixels, *self.size, self.tolerance, LEAST_START, focals)
        guided = None if start is None else self.guided(start.camera)
        return guided if guided is not None and guided.support >= LEAST_INLIERS else None

    def guided(self, camera: Camera, factors: tuple[float, ...] = GUIDED) -> Hypothesis | None:
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
        if len(points) < LEAST_OFF_CENTER:
            return centered
        asked = points, pixels, centered.camera, self.tolerance
        fixed, freed = (fit_camera(*asked, free=count) for count in (CENTERED, PARAMETERS))
        if fixed is None or freed is None or freed.support * fixed.rms < OFF_CENTER * fixed.support * freed.rms:
            return centered
        return freed

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


def look_closer(model: GaussianModel, grey: Float32, camera: Camera) -> Hypothesis | None:
    """The camera that a picture's brightness (H, W) and a render from nearly there agree on; None where too few
    keypoints do.

    They are sought where the render shows the model, and around: those of what lies behind would outnumber its own.
    Nothing is sought where, at a glance, the two have nothing in common.
    """
    found = None
    for factors in (GUIDED_FAR, GUIDED):  # the second time from where the first ended, which looks more alike
        near = look_near(model, grey, camera, LEAST_RESEMBLANCE)
        if near is None:
            return found
        look, part, window = near
        closer = look.guided(part, factors)
        if closer is None or closer.support < max(LEAST_INLIERS, 0 if found is None else found.support):
            return found
        camera = window.back(closer.camera)
        found = replace(closer, camera=camera)
    return found


def look_near(
    model: GaussianModel, grey: Float32, camera: Camera, least: float = -1.0
) -> tuple[Look, Camera, Window] | None:
    """The part of a picture's brightness (H, W) in which a camera shows the model, to be held against a render from
    there; that part's camera; and where it lies. None where there is nothing to see, or it resembles the render less
    than `least`."""
    window = Window.around(model, camera, grey)
    if window is None or window.resemblance < least:
        return None
    near = window.of(camera)
    part = resized(grey[window.rows, window.columns], near.width, near.height)
    bank = make_landmarks(model, [near.with_side(CLOSER_SIZE)])
    seen = keypoints_of(part, window.shown, CLOSER_SIZE)
    return (Look(seen, bank, (near.width, near.height), ()), near, window) if len(bank) else None


def keypoints_of(grey: Float32, shown: Bool | None = None, size: int = DETECTION_SIZE) -> Keypoints:
    """Keypoints of a picture's brightness (H, W), 0..1, reduced to a longer side of `size` pixels where it is larger;
    `shown` (h, w) of any size allows them."""
    import cv2

    height, width = grey.shape
    shrink = min(1.0, size / max(height, width))
    small = resized(grey, max(1, round(width * shrink)), max(1, round(height * shrink)))
    mask = None
    if shown is not None:
        mask = cv2.resize(shown.astype(np.uint8), small.shape[::-1], interpolation=cv2.INTER_NEAREST)
    found = detect_keypoints(small, KEYPOINTS, mask)
    return Keypoints(found.points * (width / small.shape[1], height / small.shape[0]), found.descriptors)


def _radius(landmarks: Landmarks) -> float:
    """Median distance of the landmarks from their middle, scene units."""
    if len(landmarks) == 0:
        return 0.0
    points: Float64 = landmarks.points.astype(np.float64)
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))
