"""Find the camera of a screenshot of a known model: position, direction and focal length (DESIGN 4.8).

1. Keypoints of the picture, matched to the landmarks of the record; PnP-RANSAC over a ladder of focal lengths, then a
   render from there matched once more. Where few agree, the same for the picture turned over left to right. Where a
   page is around what shows the model (`framing`), all begins anew without it.
2. Where no camera is well supported, keypoints vote for views of the bank (`voted_views`); then outlines and edges of
   many views are held against both hands (`view_search`).
3. Each candidate is refined on a small picture; the one that explains it best, in brightness and in its edges, goes on.
4. Robust Gauss-Newton on brightness against fresh renders, coarse to fine, to about a hundredth of a pixel.

The picture of another scene fails at the correlation with the render. Nothing here sees a key or a chip.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from engine.errors import InputError
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.resampling import smooth
from engine.pictures.background import fill_background
from engine.pictures.camera_hypotheses import LADDER
from engine.pictures.camera_motion import CENTERED, PARAMETERS
from engine.pictures.features import Keypoints, luma
from engine.pictures.found_camera import OWN, FoundCamera
from engine.pictures.framing import find_frame
from engine.pictures.keypoint_cameras import Look, keypoints_of, look_closer, resized
from engine.pictures.landmarks import Landmarks
from engine.pictures.pose_refinement import Refined, refine_level
from engine.pictures.view_search import ViewEdges, search_views
from engine.pictures.voted_views import vote_for_views
from engine.raster import RasterSettings, render_depth

__all__ = ["CameraConfig", "FoundCamera", "find_camera"]

LEAST_SIDE = 16  # of a picture, pixels
LEAST_CORRELATION, SURE_CORRELATION = 0.75, 0.9
"""Correlation of brightness with the render below which the picture shows something else, and above which a camera that
enough keypoints agree on is the one."""
LEAST_DETAIL = 0.7
"""The same of what the render's opacity does not explain: something else in one colour, in the shape of a view, came to
0.47, pictures of the asset to 0.80 and more."""
SUPPORTED, ENOUGH = 30, 60
"""Keypoints that agree on a camera which then needs no second opinion, if it explains the picture; and with those of a
render from nearly there, so that no further view is tried."""
SIZES = (256, 640, 1600)
"""Longer sides of the levels of the refinement, pixels; the last is the picture's own, if smaller."""
ITERATIONS, QUICK_ITERATIONS = 12, 8
"""Renders at most: of the last level, and of those before."""
STEP, QUICK_STEP = 0.005, 0.05
"""A level ends when its step is smaller, pixels."""
THUMBNAIL = 128
"""Longer side of the picture on which candidates without keypoints are refined first, pixels."""
CANDIDATES, CLOSER, FINALISTS = 12, 5, 3
"""Candidates of the search over views; how many are rendered to be matched to the picture; and how many go on."""
VOTED = 4
"""Views that keypoints vote for, the loudest, that are rendered to be matched to the picture."""
CLEARLY = 1.03
"""How much more a picture drawn in the other way must be explained by it; of either way, the wrong one came to 1.02."""
_EDGE = 0.05
"""Steps of brightness from which an edge counts in full."""


@dataclass(frozen=True)
class CameraConfig:
    """How hard `find_camera` tries."""

    focals: tuple[float, ...] = LADDER
    """Focal lengths the pose from keypoints is sought at, in widths of the picture; it is refined after."""
    other_focals: tuple[float, ...] = (1.4, 0.75, 1.9)
    """Focal lengths to start from where the refinement from the keypoints' own fails, in those."""
    framed: bool = True
    """Whether the picture may show something else around what shows the model."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A camera of the picture's size that may be the one, and what speaks for it."""

    camera: Camera
    mirrored: bool
    support: int  # keypoints that agree
    worth: float = 0.0  # how well it explains the small picture
    correlation: float = 0.0  # of render and small picture
    size: int = 0  # longer side of the picture it was refined on, pixels

    @property
    def sure(self) -> bool:
        """Whether no other needs to be looked for: what repeats itself finds keypoints that agree on a wrong camera."""
        return self.support >= SUPPORTED and self.correlation > LEAST_CORRELATION


def find_camera(
    landmarks: Landmarks,
    reference_model: GaussianModel,
    image: Float32,
    config: CameraConfig = CameraConfig(),
    edges: Callable[[], ViewEdges] | None = None,
    bank: Callable[[], Sequence[Camera]] | None = None,
) -> FoundCamera | None:
    """Camera from which a picture (h, w, 3), 0..1, shows the unmarked reference; None when no view of it was
    recognised.

    `landmarks` are those of its record; `bank` gives the views they were seen from, and `edges` those of views of it
    (asked only where keypoints do not do). InputError if the picture is not a finite (h, w, 3) image.
    """
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < LEAST_SIDE:
        raise InputError(f"a picture is (h, w, 3) and at least {LEAST_SIDE} pixels a side, got {image.shape}")
    if not np.isfinite(image).all():
        raise InputError("the picture holds values that are not finite")
    finder = _Finder(landmarks, reference_model, np.asarray(image, dtype=np.float32), config)
    candidates = finder.by_keypoints()
    first = next(candidates, None)
    frame = finder.frame(first) if config.framed and first is not None and first.support >= SUPPORTED else None
    if frame is not None and min(image[frame].shape[:2]) >= LEAST_SIDE:
        part = np.ascontiguousarray(image[frame])
        found = find_camera(landmarks, reference_model, part, replace(config, framed=False), edges, bank)
        if found is not None:
            return replace(found, frame=frame)
    best = finder.best(candidates if first is None else chain([first], candidates))
    if bank is not None and (best is None or not best.sure):
        best = finder.best(finder.by_votes(bank()), best)
    if edges is not None and (best is None or not best.sure):
        best = finder.best(finder.by_edges(edges()), best)
    return None if best is None else finder.finish(best)


class _Finder:
    """The search for the camera of one picture."""

    def __init__(self, landmarks: Landmarks, model: GaussianModel, image: Float32, config: CameraConfig) -> None:
        self._landmarks, self._model, self._image, self._config = landmarks, model, image, config
        grey = luma(image)
        self._greys = (grey, np.ascontiguousarray(grey[:, ::-1]))  # as it is, and turned over
        self._size = grey.shape[1], grey.shape[0]
        self._keypoints = keypoints_of(grey)

    def by_keypoints(self) -> Iterator[_Candidate]:
        """What keypoints agree on; the mirror image is asked where few do."""
        strongest = 0
        for mirrored in (False, True):
            if mirrored and strongest >= SUPPORTED:
                return
            look = Look.of(self._seen(mirrored), self._landmarks, self._size)
            for number, start in enumerate(look.hypotheses(self._config.focals)):
                strongest = max(strongest, start.support)
                yield _Candidate(start.camera, mirrored, start.support)
                closer = self._closer(start.camera, mirrored)  # landmarks agree on cameras a little off, too
                if closer is not None:
                    yield closer
                if number == 0:
                    for other in look.at_other_focals(start, self._config.other_focals):
                        yield _Candidate(other.camera, mirrored, other.support)

    def by_votes(self, bank: Sequence[Camera]) -> Iterator[_Candidate]:
        """What keypoints speak for together of which hardly one stands out."""
        found = []
        for mirrored in (False, True):
            voted = vote_for_views(self._seen(mirrored), self._landmarks, bank, self._size)
            found += [(view, mirrored) for view in voted[:VOTED]]
        found.sort(key=lambda each: -each[0].loudness)
        for view, mirrored in found[:VOTED]:
            look = Look(self._seen(mirrored), self._landmarks, self._size, ())
            agreed = look.agreed(view.keypoints, view.landmarks, self._config.focals)
            closer = self._closer(view.camera if agreed is None else agreed.camera, mirrored)
            if closer is not None:
                yield closer

    def by_edges(self, edges: ViewEdges) -> list[_Candidate]:
        """What outlines and edges speak for, refined on a thumbnail."""
        found = []
        for mirrored in (False, True):
            image = np.ascontiguousarray(self._image[:, ::-1]) if mirrored else self._image
            found += [(score, mirrored, camera) for score, camera in search_views(edges, image, CANDIDATES)]
        found.sort(key=lambda each: -each[0])
        tried = []
        for _, mirrored, camera in found[:CLOSER]:
            closer = self._closer(camera, mirrored)
            if closer is not None:
                tried.append(closer)
                if closer.support >= ENOUGH:
                    return tried
        for _, mirrored, camera in found[:CANDIDATES]:
            refined = self._refined(camera, mirrored, THUMBNAIL, QUICK_ITERATIONS, QUICK_STEP)
            if refined is not None:
                worth = self._worth(refined, mirrored)
                tried.append(_Candidate(self._full(refined.camera), mirrored, 0, worth))
        tried.sort(key=lambda candidate: (-candidate.support, -candidate.worth))
        finalists = tried[:FINALISTS]
        for rough in finalists:  # once refined, a view may look alike enough
            closer = self._closer(rough.camera, rough.mirrored) if not rough.support else None
            if closer is not None:
                finalists = [*finalists, closer]
        return finalists

    def _closer(self, camera: Camera, mirrored: bool) -> _Candidate | None:
        """What the picture and a render from this camera agree on."""
        closer = look_closer(self._model, self._greys[mirrored], camera)
        return None if closer is None else _Candidate(closer.camera, mirrored, closer.support)

    def best(self, candidates: Iterable[_Candidate], best: _Candidate | None = None) -> _Candidate | None:
        """The candidate that explains a small picture best, refined on it; the first that is sure ends the search.
        `best` is the best so far."""
        for candidate in candidates:
            # Where many keypoints agree the camera is right within a pixel, and a small picture would lead it astray.
            for size in SIZES[candidate.support >= SUPPORTED : 2]:
                refined = self._refined(candidate.camera, candidate.mirrored, size, QUICK_ITERATIONS, QUICK_STEP)
                if refined is not None:  # of what is thin or small, too little may be left in the smaller one
                    break
            else:
                continue
            worth = self._worth(refined, candidate.mirrored) * (SIZES[0] / size) ** 2
            if best is None or worth > best.worth:
                best = replace(
                    candidate,
                    camera=self._full(refined.camera),
                    worth=worth,
                    correlation=refined.correlation,
                    size=size,
                )
            if refined.correlation > SURE_CORRELATION and candidate.support >= SUPPORTED:
                break
        return best

    def finish(self, candidate: _Candidate) -> FoundCamera | None:
        """The camera refined up to the picture's own size; None where that does not look like the picture."""
        own = max(self._size)
        camera, refined = candidate.camera, None
        for size in [*(size for size in SIZES[:-1] if candidate.size < size < own), min(own, SIZES[-1])]:
            last = size >= min(own, SIZES[-1])
            limits = (ITERATIONS, STEP) if last else (QUICK_ITERATIONS, QUICK_STEP)
            refined = self._refined(camera, candidate.mirrored, size, *limits)
            if refined is None or refined.correlation < LEAST_CORRELATION or refined.detail < LEAST_DETAIL:
                return None
            camera = self._full(refined.camera)
        assert refined is not None
        shifted = self._refined(camera, candidate.mirrored, SIZES[-1], ITERATIONS, STEP, free=PARAMETERS)
        if shifted is not None and shifted.gain > CLEARLY * refined.gain:
            refined, camera = shifted, self._full(shifted.camera)
        drawn, otherwise = OWN, RasterSettings(antialiased=not self._model.antialiased)
        softer = self._refined(camera, candidate.mirrored, SIZES[-1], ITERATIONS, STEP, otherwise)
        if softer is not None and softer.gain > CLEARLY * refined.gain:
            refined, drawn, camera = softer, otherwise, self._full(softer.camera)
        told = (refined.rms, refined.correlation, refined.step)
        return FoundCamera(camera, candidate.support, *told, candidate.mirrored, drawn)

    def frame(self, candidate: _Candidate) -> tuple[slice, slice] | None:
        """Rows and columns in which the picture shows the model, where not in all."""
        frame = find_frame(self._model, self._greys[candidate.mirrored], candidate.camera)
        if frame is None or not candidate.mirrored:
            return frame
        rows, columns = frame
        return rows, slice(self._size[0] - columns.stop, self._size[0] - columns.start)

    def _seen(self, mirrored: bool) -> Keypoints:
        return self._keypoints.turned_over(self._size[0]) if mirrored else self._keypoints

    def _refined(
        self,
        camera: Camera,
        mirrored: bool,
        size: int,
        iterations: int,
        step: float,
        drawn: RasterSettings = OWN,
        free: int = CENTERED,
    ) -> Refined | None:
        grey = self._greys[mirrored]
        small = camera.with_side(min(size, max(grey.shape)))
        picture = resized(grey, small.width, small.height)
        return refine_level(self._model, picture, small, iterations, step, drawn, free=free)

    def _full(self, camera: Camera) -> Camera:
        """The same camera at the picture's size: square pixels, which rounding of a level's size may have bent."""
        width, height = self._size
        K = camera.resized(width, height).K.copy()
        K[0, 0] = K[1, 1] = float(np.sqrt(K[0, 0] * K[1, 1]))
        return Camera(camera.viewmat, K, width, height)

    def _worth(self, refined: Refined, mirrored: bool) -> float:
        """How much likelier the render makes the picture, times how well its edges are the picture's."""
        camera = refined.camera
        picture = resized(self._greys[mirrored], camera.width, camera.height)
        image, alpha, _ = render_depth(self._model, camera)
        behind = fill_background(picture, alpha)
        composed = luma(image) + (0.0 if behind is None else (1.0 - alpha) * behind)
        shown, seen = (_edges(smooth(np.asarray(each, dtype=np.float32), 1.0)) for each in (composed, picture))
        both = float(np.sqrt(np.square(shown).sum() * np.square(seen).sum()))
        return refined.gain * max(float((shown * seen).sum()) / max(both, 1e-9), 0.0)


def _edges(grey: Float32) -> Float32:
    """(2, H, W) gradient of brightness, strong ones counted alike."""
    gy, gx = np.gradient(grey)
    gradient = np.stack([np.asarray(gy), np.asarray(gx)])
    return np.asarray(gradient / np.sqrt(np.square(gradient).sum(axis=0) + _EDGE**2), dtype=np.float32)
