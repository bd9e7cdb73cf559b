"""Whether a picture was scaled unevenly or photographed from aside, from its keypoints (DESIGN 4.8).

Whoever fits a camera with square pixels to such a picture finds half of the matches, at a wrong place. The shape of the
pixels is fitted together with the camera; where it is far from square, that begins at shapes people make.

Nothing here sees a key or a chip.
"""

from dataclasses import replace

from engine.model import Camera, Float32, GaussianModel
from engine.pictures.camera.camera_motion import PARAMETERS, UNEVEN
from engine.pictures.camera.keypoint_cameras import Look, look_near
from engine.pictures.camera.pixel_shape import SQUARE, PixelShape
from engine.pictures.camera.pose_ransac import Hypothesis, fit_camera
from engine.pictures.landmarks.keypoints import Keypoints, luma

__all__ = ["find_shape", "refine_shape"]

RATIOS = (0.75, 1.33)
"""Ratios to start from beside 1: a wide picture made to fit an old screen, and the other way; each serves others."""
SUPPORTED = 30
"""Keypoints that must agree."""
ROUNDS = (3.0, 2.0, 1.0, 0.5, 0.5)
"""Tolerances of matching where landmarks project and of fitting, in that of an inlier: each sees more of the model."""
NOTHING = 0.006
"""How far from square nobody makes a picture: matches are no better, and taking it back would only blur it."""
LEAST, MOST, STEEPEST = 0.4, 2.5, 1.0
"""Ratios that somebody may have made, and slants: whoever crafts a picture for others does not fill our memory."""


def find_shape(look: Look, start: Camera | None, focals: tuple[float, ...]) -> Hypothesis | None:
    """Camera, and shape of a picture's pixels, on which its keypoints agree better than on square ones, how many by
    their error; None where they do not. What is flat looks nearly the same from aside: how it looks must decide.

    `start` is the best camera with square pixels; other shapes begin at each of these focal lengths, in widths
    of the picture.
    """
    plain = None if start is None else _fitted(look, start, SQUARE, PARAMETERS)
    tried = [] if start is None else [_fitted(look, start, SQUARE, UNEVEN)]
    tried += [_from_ratio(look, ratio, focals) for ratio in RATIOS]
    best = max(tried, key=_worth, default=None)
    if best is None or best.support < SUPPORTED or _worth(best) < _worth(plain):
        return None
    return best


def refine_shape(model: GaussianModel, image: Float32, found: Hypothesis) -> PixelShape | None:
    """The shape of the pixels of a picture (h, w, 3) on which it and a render from nearly there agree; None where they
    are square after all."""
    shape = found.shape
    near = look_near(model, luma(shape.undo(image)), shape.squared_camera(found.camera, *image.shape[1::-1]))
    if near is None:
        return None
    look, part, _ = near
    fitted = _fitted(look, part, SQUARE, UNEVEN)
    if fitted is not None and fitted.support >= SUPPORTED:
        shape = shape.after(fitted.shape)
    nothing = max(abs(shape.ratio - 1.0), abs(shape.slant)) < NOTHING
    return None if nothing or not _possible(shape) else shape


def _from_ratio(look: Look, ratio: float, focals: tuple[float, ...]) -> Hypothesis | None:
    shape = PixelShape(ratio)
    keypoints = Keypoints(shape.squared(look.keypoints.points), look.keypoints.descriptors)
    width, height = look.size
    squared = replace(look, keypoints=keypoints, size=(round(width / ratio), height))
    found = next(iter(squared.hypotheses(focals)), None)
    return None if found is None else _fitted(look, found.camera, shape, UNEVEN)


def _fitted(look: Look, camera: Camera, shape: PixelShape, free: int) -> Hypothesis | None:
    """A camera and, where so many numbers are free, a shape fitted to all that matches where it projects."""
    fitted = None
    for factor in ROUNDS:
        points, pixels = look.projected(camera, 3.0 * factor * look.tolerance, shape)
        if len(points) < UNEVEN:
            return None
        fitted = fit_camera(points, pixels, camera, factor * look.tolerance, free=free, shape=shape)
        if fitted is None or not _possible(fitted.shape):
            return None
        camera, shape = fitted.camera, fitted.shape
    return fitted


def _possible(shape: PixelShape) -> bool:
    return LEAST < shape.ratio < MOST and abs(shape.slant) < STEEPEST


def _worth(fitted: Hypothesis | None) -> float:
    return 0.0 if fitted is None else fitted.support / max(fitted.rms, 1e-6)
