"""Whether a picture was scaled unevenly or photographed from aside, or its model stretched, from its keypoints
(DESIGN 4.8).

A camera with square pixels, fitted to such a picture, explains half of the matches and is wrong. The shape of the
pixels is fitted together with the camera; where it is far from square, the fit starts from usual shapes.

Nothing here sees a key or a chip.
"""

from dataclasses import replace

import numpy as np

from engine.model import Camera
from engine.pictures.camera.camera_motion import PARAMETERS, SQUARE
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.keypoint_cameras import MatchedKeypoints
from engine.pictures.camera.pose_ransac import Hypothesis, fit_camera
from engine.pictures.landmarks.keypoints import Keypoints

_CONFIG = CONFIG.shape


def find_uneven(
    matched: MatchedKeypoints, start: Camera | None, focals: tuple[float, ...], *, nearly_square: bool = False
) -> Hypothesis | None:
    """Camera with whatever shape of pixels on which a picture's keypoints agree better than on square ones, how many by
    their error; None where they do not. What is flat looks nearly the same from aside: how it looks must decide.

    `start` is the best camera with square pixels; other shapes begin at each of these focal lengths, in widths
    of the picture, unless they are known to be `nearly_square`.
    """
    plain = None if start is None else _fitted(matched, start, SQUARE)
    tried = [] if start is None else [_fitted(matched, start)]
    tried += [] if nearly_square else [_from_ratio(matched, ratio, focals) for ratio in _CONFIG.ratios]
    best = max(tried, key=_support_by_error, default=None)
    if best is None or best.support < CONFIG.supported or _support_by_error(best) < _support_by_error(plain):
        return None
    return best


def is_square(camera: Camera) -> bool:
    """Whether a camera's pixels are square but for what keypoints cannot tell."""
    return bool(np.abs(camera.K[0, :2] / camera.K[1, 1] - (1.0, 0.0)).max() < _CONFIG.square)


def _from_ratio(matched: MatchedKeypoints, ratio: float, focals: tuple[float, ...]) -> Hypothesis | None:
    keypoints = Keypoints(matched.keypoints.points / (ratio, 1.0), matched.keypoints.descriptors)
    width, height = matched.size
    squared = replace(matched, keypoints=keypoints, size=(round(width / ratio), height))
    found = next(iter(squared.hypotheses(focals)), None)
    if found is None:
        return None
    return _fitted(matched, Camera(found.camera.viewmat, np.diag([ratio, 1.0, 1.0]) @ found.camera.K, width, height))


def _fitted(matched: MatchedKeypoints, camera: Camera, free: int = PARAMETERS) -> Hypothesis | None:
    """A camera fitted in so many parameters to all that matches where it projects."""
    fitted = None
    for factor in _CONFIG.rounds:
        points, pixels = matched.projected(camera, 3.0 * factor * matched.tolerance)
        if len(points) < PARAMETERS:
            return None
        fitted = fit_camera(points, pixels, camera, factor * matched.tolerance, free=free)
        if fitted is None:
            return None
        camera = fitted.camera
    return fitted


def _support_by_error(fitted: Hypothesis | None) -> float:
    return 0.0 if fitted is None else fitted.support / max(fitted.rms, 1e-6)
