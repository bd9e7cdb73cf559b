"""Find the camera of a screenshot of a known model: position, direction and focal length (DESIGN 4.8).

1. Keypoints of the picture, matched to the landmarks of the record; PnP-RANSAC over a ladder of focal lengths, then a
   render from there matched once more. Where that does not settle it, the same for the picture turned over left to
   right. Where its pixels are not square (`uneven_pixels`), or a page is around what shows the model
   (`viewer_frame`), all begins anew without that.
2. Where no camera is well supported, keypoints vote for views of the bank (`voted_views`); then outlines, edges and
   colours of many views are held against both hands (`view_search`), and cameras climb from the best (`view_climb`).
3. Each candidate is refined on a small picture; the one that explains it best, in brightness and in its edges, goes on.
4. Robust Gauss-Newton on brightness against fresh renders, coarse to fine, to about a hundredth of a pixel.

The picture of another scene fails at the correlation with the render, or at that of their details (`Refined.alike`).
Nothing here sees a key or a chip.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.errors import InputError
from engine.model import Camera, Float32, GaussianModel
from engine.pictures.camera.camera_motion import PARAMETERS
from engine.pictures.camera.camera_proposals import QUICK_ITERATIONS, QUICK_STEP, SUPPORTED, Candidate, Candidates
from engine.pictures.camera.camera_trial import Picture
from engine.pictures.camera.far_views import FarViews
from engine.pictures.camera.found_camera import FoundCamera
from engine.pictures.camera.pose_ransac import LADDER
from engine.pictures.camera.pose_refinement import Refined
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import RasterSettings

__all__ = ["CameraConfig", "FoundCamera", "find_camera", "follow_camera"]

LEAST_SIDE = 16  # of a picture, pixels
SURE_CORRELATION = 0.9
"""Correlation of brightness with the render above which a camera that enough keypoints agree on is the one."""
ALIKE = 0.96
"""The same, without what lies over the model, below which a picture may have been scaled unevenly, or a page be around
it: renders with square pixels came to 0.975 and more, others mostly to 0.7 to 0.95."""
UNCOVERED = 0.8
"""The same with it, below which a page may be around all the same: what lies over right cameras leaves 0.83 and more,
but for one picture in fifty, and the page around the photograph of a screen 0.7."""
NEARLY = 0.93
"""The same of a small picture, above which that is asked of the picture at its own size: of eight that had less, none
came to `ALIKE` there, of four that had more three."""
SIZES = (256, 640, 1600)
"""Longer sides of the levels of the refinement, pixels; the last is the picture's own, if smaller."""
ITERATIONS, STEP = 12, 0.005
"""Renders at most of the last level, and the step at which it ends, pixels."""
WITHIN = 4.0
"""A refined camera is at most so many times as far off as its last step was long: what is left is slow to show."""
SHIFTED = 0.05
"""Pixels by which freeing the principal point must move a refined picture for it to be tried: of pictures that it
explained 3 % better it was 0.07 and more, of those not cropped mostly up to 0.04."""
CLEARLY = 1.03
"""How much more a picture drawn in the other way must be explained by it; of either way, the wrong one came to 1.02."""
GLANCED = 1.02
"""The same at a glance, within about 1 % of what it is once refined."""


@dataclass(frozen=True)
class CameraConfig:
    """How hard `find_camera` tries."""

    focals: tuple[float, ...] = LADDER
    """Focal lengths the pose from keypoints is sought at, in widths of the picture; it is refined after."""
    other_focals: tuple[float, ...] = (1.4, 0.75, 1.9)
    """Focal lengths to start from where the refinement from the keypoints' own fails, in those."""
    framed: bool = True
    """Whether the picture may show something else around what shows the model."""
    uneven: bool = True
    """Whether it may have been scaled unevenly, or be the photograph of a screen."""


def find_camera(
    landmarks: Landmarks,
    reference_model: GaussianModel,
    image: Float32,
    config: CameraConfig = CameraConfig(),
    far: Callable[[], FarViews] | None = None,
    bank: Callable[[], Sequence[Camera]] | None = None,
) -> FoundCamera | None:
    """Camera from which a picture (h, w, 3), 0..1, shows the unmarked reference; None when no view of it was
    recognised.

    `landmarks` are those of its record; `bank` gives the views they were seen from, and `far` what it looks like from
    afar: both are asked only where keypoints do not do.
    InputError if the picture is not a finite (h, w, 3) image.
    """
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < LEAST_SIDE:
        raise InputError(f"a picture is (h, w, 3) and at least {LEAST_SIDE} pixels a side, got {image.shape}")
    if not np.isfinite(image).all():
        raise InputError("the picture holds values that are not finite")
    picture = Picture(reference_model, np.asarray(image, dtype=np.float32))
    candidates = Candidates(picture, landmarks, config.focals, config.other_focals)
    hands = {mirrored: candidates.by_keypoints(mirrored) for mirrored in (False, True)}
    first = next(hands[False], None)
    best = None if first is None else _best(picture, [first])
    if best is None or not _settled(best):  # what is symmetric finds many keypoints that agree in the wrong hand, too
        turned = next(hands[True], None)
        if turned is not None:
            best = _best(picture, [turned], best)
            first = turned if first is None or turned.support > first.support else first
    done, explained = None, best is not None and _explained(best)
    if best is not None and _settled(best) and best.clear > NEARLY and not explained:  # at its own size it may be
        done = _finish(picture, best)
        explained = done is not None and _explained(done)
    uneven = config.uneven and not explained
    shape = candidates.shape(first) if uneven else None
    if shape is not None:
        asked = replace(config, uneven=False)
        bent = find_camera(landmarks, reference_model, shape.undo(image), asked)
        # Something flat, near a wide lens, looks slanted until all of its perspective is found.
        plain = None
        if bent is not None and best is not None and best.sure:
            plain = find_camera(landmarks, reference_model, image, asked)
        if bent is not None and (plain is None or bent.correlation > plain.correlation):
            return replace(bent, shape=shape)
        if plain is not None:
            return plain
    framed = config.framed and not explained
    frame = candidates.frame(first) if framed and first is not None and first.support >= SUPPORTED else None
    if frame is not None and min(image[frame].shape[:2]) >= LEAST_SIDE:
        part, asked = np.ascontiguousarray(image[frame]), replace(config, framed=False, uneven=False)
        found = find_camera(landmarks, reference_model, part, asked, far, bank)
        if found is not None and not _explained(found) and done is None and best is not None:
            done = _finish(picture, best)  # a frame may be wrong
        if found is not None and (done is None or found.gain > done.gain):
            return replace(found, frame=frame)
    if done is not None:
        return done
    likelier = first is not None and first.mirrored
    best = _best(picture, hands[likelier], best)
    if first is None or first.support < SUPPORTED:
        best = _best(picture, hands[not likelier], best)
    if bank is not None and (best is None or not best.sure):
        best = _best(picture, candidates.by_votes(bank()), best)
    if far is not None and (best is None or not best.sure):
        best = _best(picture, candidates.by_edges(far()), best)
    return None if best is None else _finish(picture, best)


def follow_camera(reference_model: GaussianModel, image: Float32, last: FoundCamera) -> FoundCamera | None:
    """Camera of a picture (h, w, 3), 0..1, that was taken soon after the one `last` was found in, as the frames of a
    video are; None where it is not near that one, or explains this picture less well than a found one must.

    It starts from there and is refined as every found camera is, so it does not add up what the last was off by.
    """
    if image.ndim != 3 or min(image.shape[:2]) < LEAST_SIDE or not np.isfinite(image).all():
        return None  # the search says what is wrong with it
    face = last.face(np.asarray(image, dtype=np.float32))
    if face.shape != (last.camera.height, last.camera.width, 3):
        return None
    picture = Picture(reference_model, face)
    near = _best(picture, [Candidate(last.camera, False, 0, drawn=replace(last.drawn, antialiased=None))])
    found = None if near is None else _finish(picture, near)
    if found is None or found.correlation < min(SURE_CORRELATION, last.correlation):
        return None
    return replace(found, mirrored=last.mirrored, shape=last.shape, frame=last.frame)


def _best(picture: Picture, candidates: Iterable[Candidate], best: Candidate | None = None) -> Candidate | None:
    """The candidate that explains a small picture best, refined on it; the first that is sure ends the search.
    `best` is the best so far."""
    for candidate in () if best is not None and _settled(best) else candidates:
        # Where many keypoints agree the camera is right within a pixel, and a small picture would lead it astray.
        for size in SIZES[candidate.support >= SUPPORTED : 2]:
            refined = picture.refined(
                candidate.camera, candidate.mirrored, size, QUICK_ITERATIONS, QUICK_STEP, candidate.drawn
            )
            if refined is not None and (refined.alike or not refined.hopeful):
                break
        if refined is None:
            continue
        drawn = candidate.drawn
        if refined.hopeful:
            asked = candidate.mirrored, size, QUICK_ITERATIONS, QUICK_STEP
            other = replace(drawn, by_distance=not drawn.by_distance)
            refined, drawn = _likelier(picture, refined, drawn, other, *asked)
        full, off = picture.full(refined.camera), WITHIN * refined.step / size
        tried = replace(
            candidate,
            camera=full,
            correlation=refined.correlation,
            clear=refined.clear,
            size=size,
            off=off,
            hopeful=refined.hopeful,
            drawn=drawn,
        )
        if best is None and _settled(tried):  # nothing it need be worth more than
            return tried
        worth = picture.worth(refined, candidate.mirrored, drawn) * (SIZES[0] / size) ** 2
        if best is None or worth > best.worth:
            best = replace(tried, worth=worth)
            if _settled(best):
                break
    return best


def _likelier(
    picture: Picture,
    refined: Refined,
    drawn: RasterSettings,
    other: RasterSettings,
    mirrored: bool,
    size: int,
    iterations: int,
    step: float,
) -> tuple[Refined, RasterSettings]:
    """What was refined on renders drawn in one way, or the same on those drawn in another where that explains the
    picture clearly better; and the way."""
    camera, off = picture.full(refined.camera), WITHIN * refined.step / min(size, max(picture.size))
    glance = picture.refined(camera, mirrored, size, 1, step, other, off=off)
    if glance is not None and glance.gain > GLANCED * refined.gain:
        again = picture.refined(camera, mirrored, size, iterations, step, other, off=off)
        if again is not None and again.gain > CLEARLY * refined.gain:
            return again, other
    return refined, drawn


def _explained(camera: Candidate | FoundCamera) -> bool:
    """Whether nothing is left for another shape of pixels, or a frame, to explain."""
    return camera.clear >= ALIKE and camera.correlation >= UNCOVERED


def _settled(best: Candidate) -> bool:
    return best.correlation > SURE_CORRELATION and best.support >= SUPPORTED


def _finish(picture: Picture, candidate: Candidate) -> FoundCamera | None:
    """The camera refined up to the picture's own size; None where that does not look like the picture, or has no hope
    to."""
    if not candidate.hopeful:
        return None
    own, drawn = max(picture.size), candidate.drawn
    camera, refined, off = candidate.camera, None, candidate.off
    for size in [*(size for size in SIZES[:-1] if candidate.size < size < own), min(own, SIZES[-1])]:
        last = size >= min(own, SIZES[-1])
        limits = (ITERATIONS, STEP) if last else (QUICK_ITERATIONS, QUICK_STEP)
        refined = picture.refined(camera, candidate.mirrored, size, *limits, drawn, off=off)
        if refined is None or not refined.alike:
            return None
        camera, off = picture.full(refined.camera), WITHIN * refined.step / size
    assert refined is not None
    asked = candidate.mirrored, SIZES[-1], ITERATIONS, STEP
    if refined.shift > SHIFTED:  # and then by far: without its principal point a camera is wrong in all else
        shifted = picture.refined(camera, *asked, drawn, free=PARAMETERS)
        if shifted is not None and shifted.gain > CLEARLY * refined.gain:
            refined, camera = shifted, picture.full(shifted.camera)
    softer = replace(drawn, antialiased=not picture.model.antialiased)
    refined, drawn = _likelier(picture, refined, drawn, softer, *asked)
    camera = picture.full(refined.camera)
    gain = refined.gain * (own / min(own, SIZES[-1])) ** 2
    told = refined.rms, refined.correlation, refined.step, gain, refined.clear
    return FoundCamera(camera, candidate.support, *told, candidate.mirrored, drawn)
