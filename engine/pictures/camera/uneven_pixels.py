"""Whether a picture was scaled unevenly or photographed from aside, from its keypoints (DESIGN 4.8).

A camera with square pixels, fitted to such a picture, explains half of the matches and is wrong. The shape of the
pixels is fitted together with the camera; where it is far from square, the fit starts from usual shapes.

Nothing here sees a key or a chip.
"""

from dataclasses import replace

from engine.model import Camera, Float32, GaussianModel
from engine.pictures.camera.camera_motion import PARAMETERS, UNEVEN
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.keypoint_cameras import MatchedKeypoints, match_near
from engine.pictures.camera.pixel_shape import SQUARE, PixelShape
from engine.pictures.camera.pose_ransac import Hypothesis, fit_camera
from engine.pictures.landmarks.keypoints import Keypoints, luma

_CONFIG = CONFIG.shape


def find_shape(
    matched: MatchedKeypoints, start: Camera | None, focals: tuple[float, ...], *, nearly_square: bool = False
) -> Hypothesis | None:
    """Camera, and shape of a picture's pixels, on which its keypoints agree better than on square ones, how many by
    their error; None where they do not. What is flat looks nearly the same from aside: how it looks must decide.

    `start` is the best camera with square pixels; other shapes begin at each of these focal lengths, in widths
    of the picture, unless they are known to be `nearly_square`.
    """
    plain = None if start is None else _fitted(matched, start, SQUARE, PARAMETERS)
    tried = [] if start is None else [_fitted(matched, start, SQUARE, UNEVEN)]
    tried += [] if nearly_square else [_from_ratio(matched, ratio, focals) for ratio in _CONFIG.ratios]
    best = max(tried, key=_support_by_error, default=None)
    if best is None or best.support < CONFIG.supported or _support_by_error(best) < _support_by_error(plain):
        return None
    return best


def refine_shape(model: GaussianModel, image: Float32, found: Hypothesis) -> PixelShape | None:
    """The shape of the pixels of a picture (h, w, 3) on which it and a render from nearly there agree; None where they
    are square after all."""
    shape = found.shape
    near = match_near(model, luma(shape.undo(image)), shape.squared_camera(found.camera, *image.shape[1::-1]))
    if near is None:
        return None
    fitted = _fitted(near.matched, near.camera, SQUARE, UNEVEN)
    if fitted is not None and fitted.support >= CONFIG.supported:
        shape = shape.after(fitted.shape)
    square = max(abs(shape.ratio - 1.0), abs(shape.slant)) < _CONFIG.square
    return None if square or not _possible(shape) else shape


def _from_ratio(matched: MatchedKeypoints, ratio: float, focals: tuple[float, ...]) -> Hypothesis | None:
    shape = PixelShape(ratio)
    keypoints = Keypoints(shape.squared(matched.keypoints.points), matched.keypoints.descriptors)
    width, height = matched.size
    squared = replace(matched, keypoints=keypoints, size=(round(width / ratio), height))
    found = next(iter(squared.hypotheses(focals)), None)
    return None if found is None else _fitted(matched, found.camera, shape, UNEVEN)


def _fitted(matched: MatchedKeypoints, camera: Camera, shape: PixelShape, free: int) -> Hypothesis | None:
    """A camera and, where so many numbers are free, a shape fitted to all that matches where it projects."""
    fitted = None
    for factor in _CONFIG.rounds:
        points, pixels = matched.projected(camera, 3.0 * factor * matched.tolerance, shape)
        if len(points) < UNEVEN:
            return None
        fitted = fit_camera(points, pixels, camera, factor * matched.tolerance, free=free, shape=shape)
        if fitted is None or not _possible(fitted.shape):
            return None
        camera, shape = fitted.camera, fitted.shape
    return fitted


def _possible(shape: PixelShape) -> bool:
    low, high = _CONFIG.ratio_range
    return low < shape.ratio < high and abs(shape.slant) < _CONFIG.most_slant


def _support_by_error(fitted: Hypothesis | None) -> float:
    return 0.0 if fitted is None else fitted.support / max(fitted.rms, 1e-6)
