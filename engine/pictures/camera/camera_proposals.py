"""Candidate cameras of a picture, from keypoints, from their votes, and from outlines and edges (DESIGN 4.8).

Nothing here sees a key or a chip.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from engine.model import Camera
from engine.pictures.camera.camera_trial import Picture
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.far_views import FarViews
from engine.pictures.camera.keypoint_cameras import MatchedKeypoints, keypoints_of
from engine.pictures.camera.picture_edges import PictureEdges
from engine.pictures.camera.pose_refinement import DEFAULT_SETTINGS
from engine.pictures.camera.uneven_pixels import find_uneven, is_square
from engine.pictures.camera.view_points import ViewPoints
from engine.pictures.camera.view_search import Climbed, climb, search_views
from engine.pictures.camera.viewer_frame import find_frame
from engine.pictures.camera.voted_views import VotedView, vote_for_views
from engine.pictures.landmarks.keypoints import Keypoints
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import RasterSettings


@dataclass(frozen=True, eq=False)
class Candidate:
    """A camera of the picture's size that may be the one, and what speaks for it."""

    camera: Camera
    mirrored: bool
    support: int  # keypoints that agree
    score: float = 0.0  # how well it explains the small picture
    correlation: float = 0.0  # of render and small picture
    uncovered_correlation: float = 0.0  # of both where nothing lies over the model
    side: int = 0  # longer side of the picture it was refined on, pixels; 0 before
    max_error: float = np.inf  # longer sides of the picture
    hopeful: bool = True  # whether a larger picture may show that it is right
    settings: RasterSettings = DEFAULT_SETTINGS  # with which the render is most like the picture

    @property
    def supported(self) -> bool:
        """Whether keypoints agree on it that hardly ever agree by chance."""
        return self.support >= CONFIG.supported

    @property
    def sure(self) -> bool:
        """Whether costlier searches can be spared: repetitive models have many keypoints that agree on a wrong camera,
        whose render does not correlate."""
        return self.supported and self.correlation > CONFIG.refinement.least_correlation

    @property
    def settled(self) -> bool:
        """Whether it ends the search among candidates: pixels that are not square fit much, if not well."""
        least = CONFIG.settled_correlation if is_square(self.camera) else CONFIG.explained_uncovered
        return self.supported and self.correlation > least


class Candidates:
    """Candidates of one picture; `focals` in its widths, `other_focals` in the focal length found."""

    def __init__(
        self, picture: Picture, landmarks: Landmarks, focals: tuple[float, ...], other_focals: tuple[float, ...]
    ) -> None:
        self._picture, self._landmarks, self._focals, self._other_focals = picture, landmarks, focals, other_focals
        self._keypoints = keypoints_of(picture.grays[False])
        self._matched: dict[bool, MatchedKeypoints] = {}  # by whether the picture is mirrored
        self._voted: list[tuple[VotedView, bool]] = []

    def by_keypoints(self, mirrored: bool) -> Iterator[Candidate]:
        """Cameras that keypoints of the picture, or of its mirror image, agree on, by falling support."""
        matched = self._matches(mirrored)
        for number, start in enumerate(matched.hypotheses(self._focals)):
            yield Candidate(start.camera, mirrored, start.support)
            closer = self._closer(start.camera, mirrored)  # landmarks agree on cameras a little off, too
            if closer is not None:
                yield closer
            if number == 0 and start.support >= CONFIG.keypoints.least_freed:  # fewer say little of the lens
                for other in matched.at_other_focals(start, self._other_focals):
                    yield Candidate(other.camera, mirrored, other.support)

    def by_votes(self, bank: Sequence[Camera]) -> Iterator[Candidate]:
        """Cameras of the views that most keypoints vote for, where single matches are not distinctive."""
        found = []
        for mirrored in (False, True):
            voted = vote_for_views(self._seen(mirrored), self._landmarks, bank, self._picture.size)
            loudest = voted[: CONFIG.votes.views]
            found += [(view, mirrored) for view in loudest if view.loudness > CONFIG.votes.least_loudness]
        found.sort(key=lambda each: -each[0].loudness)
        self._voted = found[: CONFIG.votes.views]
        for view, mirrored in self._voted:
            matched = MatchedKeypoints(self._seen(mirrored), self._landmarks, self._picture.size, ())
            agreed = matched.agreed(view.keypoints, view.landmarks, self._focals)
            closer = self._closer(view.camera if agreed is None else agreed.camera, mirrored)
            if closer is not None:
                yield closer

    def by_edges(self, far: FarViews, parts: bool = True) -> Iterator[Candidate]:
        """Cameras that fit by outlines, edges and colors: climbed to from the best views and from the voted ones; and
        from close-ups, where nothing fits well and the picture may show `parts`."""
        pictures = [PictureEdges.of(self._picture.turned(mirrored)) for mirrored in (False, True)]
        starts = _starts(far.views, pictures, CONFIG.edges.radii)
        for view, mirrored in self._voted:
            height, width = pictures[mirrored].small.shape[:2]
            starts.append(Climbed(0.0, view.camera.resized(width, height), int(mirrored)))
        climbed = climb(far.model, pictures, starts)
        if parts and max((each.score for each in climbed), default=0.0) < CONFIG.edges.fitting:
            nearer = climb(far.model, pictures, _starts(far.parts, pictures, CONFIG.edges.close_radii))
            climbed = sorted([*climbed, *nearer], key=lambda each: -each.score)[: CONFIG.edges.rounds[-1].kept]
        for each in (one for one in climbed if one.score > CONFIG.edges.least_score):
            camera, mirrored = self._picture.full(each.camera), bool(each.picture)
            closer = self._closer(camera, mirrored)
            yield Candidate(camera, mirrored, 0) if closer is None else closer

    def _closer(self, camera: Camera, mirrored: bool) -> Candidate | None:
        """The camera that the picture and a render from this one agree on."""
        closer = self._picture.closer(camera, mirrored)
        return None if closer is None else Candidate(closer.camera, mirrored, closer.support)

    def frame(self, candidate: Candidate) -> tuple[slice, slice] | None:
        """Rows and columns of the frame in which the picture shows the model; None where it fills the picture."""
        frame = find_frame(self._picture.model, self._picture.grays[candidate.mirrored], candidate.camera)
        if frame is None or not candidate.mirrored:
            return frame
        rows, columns = frame
        return rows, slice(self._picture.size[0] - columns.stop, self._picture.size[0] - columns.start)

    def uneven(self, first: Candidate | None, settled: bool) -> Candidate | None:
        """A camera whose pixels are not square; `first` is what keypoints agree on if they are, and its render is that
        of a `settled` candidate: pixels far from square leave none."""
        mirrored = first is not None and first.mirrored
        start = None if first is None else first.camera
        found = find_uneven(self._matches(mirrored), start, self._focals, nearly_square=settled)
        closer = None if found is None else self._closer(found.camera, mirrored)
        return None if closer is None or is_square(closer.camera) else closer

    def _matches(self, mirrored: bool) -> MatchedKeypoints:
        if mirrored not in self._matched:
            self._matched[mirrored] = MatchedKeypoints.of(self._seen(mirrored), self._landmarks, self._picture.size)
        return self._matched[mirrored]

    def _seen(self, mirrored: bool) -> Keypoints:
        return self._keypoints.turned_over(self._picture.size[0]) if mirrored else self._keypoints


def _starts(views: Sequence[ViewPoints], pictures: Sequence[PictureEdges], radii: tuple[float, ...]) -> list[Climbed]:
    """From where cameras climb: the best of both hands."""
    found = [
        Climbed(score, camera, hand)
        for hand, picture in enumerate(pictures)
        for score, camera in search_views(views, picture, CONFIG.edges.starts, radii)
    ]
    return sorted(found, key=lambda each: -each.score)[: CONFIG.edges.starts]
