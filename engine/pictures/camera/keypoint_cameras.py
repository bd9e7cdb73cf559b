"""Cameras that the keypoints of a picture and the landmarks of a model agree on (DESIGN 4.8).

And how well a reduced render correlates with the part of the picture in which such a camera sees the model.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.model import Bool, Camera, Float32, Float64, GaussianModel, Int64
from engine.numerics.resampling import resized, smooth
from engine.pictures.alignment.detail import correlation
from engine.pictures.camera.camera_motion import PARAMETERS, SQUARE
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.pose_ransac import Hypothesis, at_other_focal, fit_camera, hypothesize
from engine.pictures.landmarks.keypoints import Keypoints, detect_keypoints, luma
from engine.pictures.landmarks.landmark_matching import match_landmarks, match_projected
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from engine.raster import render_depth

_CONFIG = CONFIG.keypoints


@dataclass(frozen=True, eq=False)
class MatchedKeypoints:
    """Keypoints of a picture, and the landmarks (indices) they may show: few, mostly right, then many, mostly wrong."""

    keypoints: Keypoints
    landmarks: Landmarks
    size: tuple[int, int]  # width and height of the picture
    matches: Sequence[tuple[Int64, Int64]]

    @classmethod
    def of(cls, keypoints: Keypoints, landmarks: Landmarks, size: tuple[int, int]) -> "MatchedKeypoints":
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
        return None if fitted is None else self._freed(fitted)

    def _freed(self, centered: Hypothesis) -> Hypothesis:
        """The camera of a picture of which a part was cut off, or of a model that was stretched, where clearly more
        keypoints agree with that."""
        points, pixels = self.projected(centered.camera, 3.0 * self.tolerance)
        if len(points) < _CONFIG.least_freed:
            return centered
        best, least = centered, fit_camera(points, pixels, centered.camera, self.tolerance)
        for free in (SQUARE, PARAMETERS):
            freed = fit_camera(points, pixels, centered.camera, self.tolerance, free=free)
            if least is None or freed is None:
                break
            if freed.support * least.rms >= _CONFIG.freed_gain * least.support * freed.rms:
                best = least = freed
        return best

    def at_other_focals(self, hypothesis: Hypothesis, factors: Sequence[float]) -> Iterator[Hypothesis]:
        """Cameras of other focal lengths with which the keypoints agree about as well."""
        points, pixels = self.projected(hypothesis.camera, self.tolerance)
        for factor in factors:
            other = at_other_focal(points, pixels, hypothesis, factor, 0.5 * self.tolerance)
            if other is not None:
                yield other

    def projected(self, camera: Camera, radius: float) -> tuple[Float64, Float64]:
        """Landmarks (M, 3) and the keypoints (M, 2) that look like them within so many pixels of their projections."""
        keypoint, landmark = match_projected(self.keypoints, self.landmarks, camera, radius)
        return self.landmarks.points[landmark].astype(np.float64), self.keypoints.points[keypoint]


def match_closer(model: GaussianModel, gray: Float32, camera: Camera) -> Hypothesis | None:
    """The camera that a picture's brightness (H, W) and a render from nearly there agree on; None where too few
    keypoints do.

    Keypoints are detected where the render shows the model, and around: those of the background would outnumber them.
    Nothing is sought where the two, reduced, do not correlate.
    """
    found = None
    for factors in (_CONFIG.guided_far, _CONFIG.guided):  # the second from where the first ended: it is nearer
        near = match_near(model, gray, camera)
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
    window: "Window"  # where the part lies


def match_near(model: GaussianModel, gray: Float32, camera: Camera) -> NearRender | None:
    """The part of a picture's brightness (H, W) in which a camera sees the model, matched to a render from there; None
    where the camera does not see the model, or picture and render have nothing in common."""
    window = Window.around(model, camera, gray)
    if window is None or window.resemblance < _CONFIG.least_resemblance:
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


@dataclass(frozen=True, eq=False)
class Window:
    """The part of a picture that shows a model and its surroundings, and by how much it is enlarged."""

    rows: slice
    columns: slice
    picture: Camera  # of the whole
    factor: float
    shown: Bool  # (h, w) of the part, much reduced: the model, and what is near
    resemblance: float  # of picture and render there, -1 to 1

    @classmethod
    def around(cls, model: GaussianModel, camera: Camera, gray: Float32) -> "Window | None":
        """Where a camera sees the model, in a picture of this brightness (H, W); None where it does not."""
        import cv2

        small = camera.with_side(_CONFIG.glance_side)
        image, alpha, _ = render_depth(model, small)
        seen = alpha > _CONFIG.glance_alpha
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if not len(rows):
            return None
        low, high = np.array([rows[0], columns[0]]), np.array([rows[-1], columns[-1]]) + 1
        margin = int(np.ceil(_CONFIG.surroundings * (high - low).max()))
        near = cv2.dilate(seen.astype(np.uint8), np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)) > 0
        low, high = np.maximum(low - margin, 0), np.minimum(high + margin, seen.shape)
        shown = near[low[0] : high[0], low[1] : high[1]]
        scale = np.array([camera.height / small.height, camera.width / small.width])
        (top, left), (bottom, right) = np.floor(low * scale).astype(int), np.ceil(high * scale).astype(int)
        factor = max(1.0, _CONFIG.closer_side / max(bottom - top, right - left))
        alike = _resemblance(resized(gray, small.width, small.height), luma(image), alpha)
        return cls(slice(int(top), int(bottom)), slice(int(left), int(right)), camera, float(factor), shown, alike)

    def of(self, camera: Camera) -> Camera:
        """The camera of this part of its picture."""
        K = camera.K.copy()
        K[:2, 2] -= self.columns.start, self.rows.start
        K[:2] *= self.factor
        width, height = (round(self.factor * (part.stop - part.start)) for part in (self.columns, self.rows))
        return Camera(camera.viewmat, K, width, height)

    def back(self, camera: Camera) -> Camera:
        """The camera of the whole picture, of this part's."""
        K = camera.K / self.factor
        K[:2, 2] += self.columns.start, self.rows.start
        K[2, 2] = 1.0
        return Camera(camera.viewmat, K, self.picture.width, self.picture.height)


def _resemblance(seen: Float32, drawn: Float32, alpha: Float32) -> float:
    """The larger correlation, -1 to 1, of brightness within the model and of its steps there and at its outline: a
    picture (h, w), and a render of this opacity. Tone curves spoil the first, many leaves the second."""
    import cv2

    inside = alpha > _CONFIG.glance_alpha
    side = 2 * _CONFIG.outline + 1
    around = cv2.dilate(inside.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    behind = float(np.median(seen[~around])) if not around.all() else 0.0
    seen, drawn = (smooth(each, _CONFIG.soft) for each in (seen, drawn + (1.0 - alpha) * np.float32(behind)))
    steps = (np.hypot(*np.gradient(each))[around] for each in (seen, drawn))
    return max(correlation(seen[inside], drawn[inside]), correlation(*steps))
