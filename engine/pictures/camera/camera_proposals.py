"""Cameras a picture may have been taken by: what keypoints, votes of keypoints, outlines and edges speak for
(DESIGN 4.8).

Nothing here sees a key or a chip.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from engine.model import Camera
from engine.pictures.camera.camera_trial import Picture
from engine.pictures.camera.far_views import FarViews
from engine.pictures.camera.found_camera import OWN
from engine.pictures.camera.keypoint_cameras import Look, keypoints_of
from engine.pictures.camera.picture_edges import PictureEdges
from engine.pictures.camera.pixel_shape import PixelShape
from engine.pictures.camera.pose_refinement import LEAST_CORRELATION
from engine.pictures.camera.uneven_pixels import find_shape, refine_shape
from engine.pictures.camera.view_climb import KEPT, Climbed, climb
from engine.pictures.camera.view_points import ViewPoints
from engine.pictures.camera.view_search import LARGE, RADII, search_views
from engine.pictures.camera.viewer_frame import find_frame
from engine.pictures.camera.voted_views import VotedView, vote_for_views
from engine.pictures.landmarks.keypoints import Keypoints
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import RasterSettings

__all__ = ["QUICK_ITERATIONS", "QUICK_STEP", "SUPPORTED", "Candidate", "Candidates"]

SUPPORTED = 30
"""Keypoints that agree on a camera which then needs no second opinion, if it explains the picture."""
QUICK_ITERATIONS, QUICK_STEP = 8, 0.05
"""Renders at most of a level of the refinement before the last, and the step at which it ends, pixels."""
CANDIDATES = 12
"""Of the search over views, from which cameras climb."""
FITS = 9.0
"""Score of a climbed camera below which close-ups are searched, too: right ones come to 8.5 and mostly to 12 to 16,
wrong ones to 6 to 8.5, of one picture in fifty to 9.1."""
VOTED, LOUD = 4, 1.3
"""Views that keypoints vote for, the loudest, that are rendered to be matched to the picture; and how loud they must
be: of five pictures that keypoints alone do not find, three right views have 1.9 and more, wrong ones up to 1.2."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A camera of the picture's size that may be the one, and what speaks for it."""

    camera: Camera
    mirrored: bool
    support: int  # keypoints that agree
    worth: float = 0.0  # how well it explains the small picture
    correlation: float = 0.0  # of render and small picture
    clear: float = 0.0  # the same without what lies over the model
    size: int = 0  # longer side of the picture it was refined on, pixels
    off: float = np.inf  # at most, longer sides of the picture
    hopeful: bool = True  # whether a larger picture may show that it is right
    drawn: RasterSettings = OWN  # how the model looks most like the picture

    @property
    def sure(self) -> bool:
        """Whether no other needs to be looked for: what repeats itself finds keypoints that agree on a wrong camera."""
        return self.support >= SUPPORTED and self.correlation > LEAST_CORRELATION


class Candidates:
    """Those of one picture, sought with so many focal lengths, in widths of it, and others beside those found."""

    def __init__(
        self, picture: Picture, landmarks: Landmarks, focals: tuple[float, ...], other_focals: tuple[float, ...]
    ) -> None:
        self._picture, self._landmarks, self._focals, self._other_focals = picture, landmarks, focals, other_focals
        self._keypoints = keypoints_of(picture.greys[False])
        self._looks: dict[bool, Look] = {}  # what they match, by hand
        self._voted: list[tuple[VotedView, bool]] = []

    def by_keypoints(self, mirrored: bool) -> Iterator[Candidate]:
        """What keypoints of the picture as it is, or of its mirror image, agree on: most of them first."""
        look = self._look(mirrored)
        for number, start in enumerate(look.hypotheses(self._focals)):
            yield Candidate(start.camera, mirrored, start.support)
            closer = self._closer(start.camera, mirrored)  # landmarks agree on cameras a little off, too
            if closer is not None:
                yield closer
            if number == 0:
                for other in look.at_other_focals(start, self._other_focals):
                    yield Candidate(other.camera, mirrored, other.support)

    def by_votes(self, bank: Sequence[Camera]) -> Iterator[Candidate]:
        """What keypoints speak for together of which hardly one stands out."""
        found = []
        for mirrored in (False, True):
            voted = vote_for_views(self._seen(mirrored), self._landmarks, bank, self._picture.size)
            found += [(view, mirrored) for view in voted[:VOTED] if view.loudness > LOUD]
        found.sort(key=lambda each: -each[0].loudness)
        self._voted = found[:VOTED]
        for view, mirrored in self._voted:
            look = Look(self._seen(mirrored), self._landmarks, self._picture.size, ())
            agreed = look.agreed(view.keypoints, view.landmarks, self._focals)
            closer = self._closer(view.camera if agreed is None else agreed.camera, mirrored)
            if closer is not None:
                yield closer

    def by_edges(self, far: FarViews) -> Iterator[Candidate]:
        """What outlines, edges and colours speak for, from the search over views on, and from what was voted for; from
        views of parts, too, where nothing fits well."""
        pictures = [PictureEdges.of(self._picture.turned(mirrored)) for mirrored in (False, True)]
        starts = _starts(far.views, pictures, RADII)
        for view, mirrored in self._voted:
            height, width = pictures[mirrored].small.shape[:2]
            starts.append(Climbed(0.0, view.camera.resized(width, height), int(mirrored)))
        climbed = climb(far.model, pictures, starts)
        if max((each.score for each in climbed), default=0.0) < FITS:
            nearer = climb(far.model, pictures, _starts(far.parts, pictures, LARGE))
            climbed = sorted([*climbed, *nearer], key=lambda each: -each.score)[:KEPT]
        for each in climbed:
            camera, mirrored = self._picture.full(each.camera), bool(each.picture)
            closer = self._closer(camera, mirrored)
            yield Candidate(camera, mirrored, 0) if closer is None else closer

    def _closer(self, camera: Camera, mirrored: bool) -> Candidate | None:
        """What the picture and a render from this camera agree on."""
        closer = self._picture.closer(camera, mirrored)
        return None if closer is None else Candidate(closer.camera, mirrored, closer.support)

    def frame(self, candidate: Candidate) -> tuple[slice, slice] | None:
        """Rows and columns in which the picture shows the model, where not in all."""
        frame = find_frame(self._picture.model, self._picture.greys[candidate.mirrored], candidate.camera)
        if frame is None or not candidate.mirrored:
            return frame
        rows, columns = frame
        return rows, slice(self._picture.size[0] - columns.stop, self._picture.size[0] - columns.start)

    def shape(self, first: Candidate | None) -> PixelShape | None:
        """Shape of the picture's pixels, where they are not square; `first` is what keypoints agree on if they are."""
        mirrored = first is not None and first.mirrored
        found = find_shape(self._look(mirrored), None if first is None else first.camera, self._focals)
        if found is None:
            return None
        shape = refine_shape(self._picture.model, self._picture.turned(mirrored), found)
        return shape.turned_over() if shape is not None and mirrored else shape

    def _look(self, mirrored: bool) -> Look:
        if mirrored not in self._looks:
            self._looks[mirrored] = Look.of(self._seen(mirrored), self._landmarks, self._picture.size)
        return self._looks[mirrored]

    def _seen(self, mirrored: bool) -> Keypoints:
        return self._keypoints.turned_over(self._picture.size[0]) if mirrored else self._keypoints


def _starts(views: Sequence[ViewPoints], pictures: Sequence[PictureEdges], radii: tuple[float, ...]) -> list[Climbed]:
    """From where cameras climb: the best of both hands."""
    found = [
        Climbed(score, camera, hand)
        for hand, picture in enumerate(pictures)
        for score, camera in search_views(views, picture, CANDIDATES, radii)
    ]
    return sorted(found, key=lambda each: -each.score)[:CANDIDATES]
