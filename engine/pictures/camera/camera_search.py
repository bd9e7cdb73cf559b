"""Find the camera of a screenshot of a known model: position, direction and focal length (DESIGN 4.8).

`find_camera` takes these steps, and ends as soon as one gives a camera that needs no further search:

1. Strongest keypoint candidates. Keypoints of the picture are matched to landmarks of the record; PnP-RANSAC over a
   ladder of focal lengths gives a camera, which is refined on a small picture. If that is nearly right, what picture
   and render from there agree on is looked at. If that does not settle it, the picture's mirror image competes.
2. Full size at once, for a settled candidate that nearly explains the small picture, or where the picture is blurred.
3. A plain ground with something small on it (`find_subject`): the search begins again with that alone. Outlines are
   sought in a picture of 96 pixels, details compared in one of 320: too few for an asset that takes up a third of it.
4. Pixels that are not square (`uneven_pixels`), as a stretched model's are, too: a camera that has them.
5. A page around the viewer (`viewer_frame`): the search begins again within the frame.
6. The camera of step 2, 4 or 5, if there is one, is the result.
7. All other keypoint candidates. Steps 7 to 9 are left out where step 1 has explained the picture.
8. Views of the bank that keypoints vote for (`voted_views`).
9. Outlines, edges and colors of many views (`view_search`), and a climb from the best.
10. The best candidate is refined to full size: robust Gauss-Newton on brightness against fresh renders, blurred as the
   picture is (`alignment.blur`), to about a hundredth of a pixel.

A picture of another scene fails at the correlation with the render, or at the correlation of their details
(`Refined.alike`). Nothing here sees a key or a chip.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice

import numpy as np

from engine.errors import InputError
from engine.model import Camera, Float32, GaussianModel
from engine.pictures.alignment.blur import Blur
from engine.pictures.camera.camera_motion import PARAMETERS
from engine.pictures.camera.camera_proposals import Candidate, Candidates
from engine.pictures.camera.camera_trial import Picture
from engine.pictures.camera.config import CONFIG, Level
from engine.pictures.camera.far_views import FarViews
from engine.pictures.camera.pose_refinement import DEFAULT_SETTINGS, Refined
from engine.pictures.camera.uneven_pixels import is_square
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import RasterSettings


@dataclass(frozen=True, eq=False)
class FoundCamera:
    """The camera of a picture."""

    camera: Camera  # of what `face` makes of the picture
    inliers: int  # matches that agree with the pose found from keypoints; 0 where these did not help
    rms: float  # robust standard deviation of the brightness residual, 0..1
    correlation: float  # of picture and render, -1..1
    step: float  # root mean square flow of the last step of the refinement, pixels
    gain: float = 0.0  # how much likelier its render makes the picture than a flat colour does, natural logarithm
    uncovered_correlation: float = 0.0  # of picture and render where nothing lies over the model
    mirrored: bool = False  # it is the camera of the picture turned over left to right
    settings: RasterSettings = DEFAULT_SETTINGS  # with which the render of the reference is most like it
    frame: tuple[slice, slice] | None = None  # rows and columns in which that picture shows it, where not in all

    def face(self, image: Float32) -> Float32:
        """The picture (h, w, 3) as this camera sees it: cut to its frame, turned over left to right if mirrored."""
        if self.frame is not None:
            image = np.ascontiguousarray(image[self.frame])
        return np.ascontiguousarray(image[:, ::-1]) if self.mirrored else image

    def of_whole(self, image: Float32) -> Camera:
        """The camera of the whole picture (h, w, 3), turned over if mirrored."""
        height, width = image.shape[:2]
        if self.frame is None:
            return self.camera
        rows, columns = self.frame
        K = self.camera.K.copy()
        K[:2, 2] += width - columns.stop if self.mirrored else columns.start, rows.start
        return Camera(self.camera.viewmat, K, width, height)


@dataclass(frozen=True)
class CameraConfig:
    """How hard `find_camera` tries; what it is tuned with stands in `config`."""

    focals: tuple[float, ...] = CONFIG.focals  # at which poses from keypoints are sought, widths of the picture
    other_focals: tuple[float, ...] = CONFIG.other_focals  # tried where refinement from these fails, in those
    framed: bool = True  # the picture may show something else around the viewer
    parts: bool = True  # it may show a part of the model, large
    uneven: bool = True  # it may have been scaled unevenly, be the photograph of a screen, or of a stretched model


@dataclass(frozen=True, eq=False)
class _FirstLook:
    """Result of steps 1 and 2."""

    strongest: Candidate | None  # of the first keypoint candidates, the one with most inliers, as proposed
    best: Candidate | None  # of these, the one that explains the small picture best, refined on it
    full: FoundCamera | None = None  # the best one at full size, if step 2 refined it

    @property
    def explained(self) -> bool:
        """Whether the picture is explained, on the largest size it was tried at."""
        latest = self.full or self.best
        return latest is not None and _explained(latest)


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

    `landmarks` are those of its record; `bank` gives the views they were seen from, and `far` the model from afar:
    both are called only where keypoints do not suffice.
    InputError if the picture is not a finite (h, w, 3) image.
    """
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < CONFIG.least_side:
        size = " x ".join(map(str, image.shape[1::-1]))
        raise InputError(f"a picture of {size} pixels: {CONFIG.least_side} a side and three colors are needed")
    if not np.isfinite(image).all():
        raise InputError("the picture holds values that are not finite: save it again as 8-bit RGB")
    if max(np.ptp(image[..., c]) for c in range(3)) < CONFIG.least_spread:
        return None  # one color: nothing to find, and every search would run to its end
    picture = Picture(reference_model, np.asarray(image, dtype=np.float32))
    candidates = Candidates(picture, landmarks, config.focals, config.other_focals)
    keypoint_candidates = {mirrored: candidates.by_keypoints(mirrored) for mirrored in (False, True)}
    look = _first_look(picture, keypoint_candidates)  # 1, 2
    subject = find_subject(image) if config.framed and not look.explained else None
    if subject is not None:  # 3
        return _of_subject(image, subject, config, partial(find_camera, landmarks, reference_model, far=far, bank=bank))
    square = look
    if config.uneven and not look.explained:  # 4
        look = _with_uneven_pixels(look, picture, candidates)
    found = look.full
    if config.framed and not look.explained:  # 5
        inner = replace(config, framed=False, uneven=look is not square)
        search = partial(find_camera, landmarks, reference_model, config=inner, far=far, bank=bank)
        found = _within_frame(look, picture, candidates, image, search)
    if found is not None:  # 6
        return found
    best = look.best
    if best is None or not look.explained:
        best = _searched_on(picture, candidates, keypoint_candidates, look, config.parts, far, bank)
    return None if best is None else _refine_to_full_size(picture, best)  # 10


def _searched_on(
    picture: Picture,
    candidates: Candidates,
    keypoint_candidates: dict[bool, Iterator[Candidate]],
    look: _FirstLook,
    parts: bool,
    far: Callable[[], FarViews] | None,
    bank: Callable[[], Sequence[Camera]] | None,
) -> Candidate | None:
    """Steps 7 to 9: the best of all candidates."""
    strongest = look.strongest
    mirrored = strongest is not None and strongest.mirrored
    best = _best_candidate(picture, keypoint_candidates[mirrored], look.best)
    if strongest is None or not strongest.supported:
        best = _best_candidate(picture, keypoint_candidates[not mirrored], best)
    if bank is not None and (best is None or not best.sure):
        best = _best_candidate(picture, candidates.by_votes(bank()), best)
    if far is not None and (best is None or not best.sure):
        best = _best_candidate(picture, candidates.by_edges(far(), parts), best)
    return best


def follow_camera(reference_model: GaussianModel, image: Float32, last: FoundCamera) -> FoundCamera | None:
    """Camera of a picture (h, w, 3), 0..1, that was taken soon after the picture of `last`, as the frames of a video
    are; None where it is not near that camera, or explains this picture less well than a found camera must.

    The refinement starts from `last` and ends where that of every found camera ends, so errors do not add up.
    """
    if image.ndim != 3 or min(image.shape[:2]) < CONFIG.least_side or not np.isfinite(image).all():
        return None  # `find_camera` says what is wrong with it
    face = last.face(np.asarray(image, dtype=np.float32))
    if face.shape != (last.camera.height, last.camera.width, 3):
        return None
    picture = Picture(reference_model, face)
    start = Candidate(last.camera, False, 0, settings=replace(last.settings, antialiased=None))
    near = _best_candidate(picture, [start])
    found = None if near is None else _refine_to_full_size(picture, near)
    if found is None or found.correlation < min(CONFIG.settled_correlation, last.correlation):
        return None
    return replace(found, mirrored=last.mirrored, frame=last.frame)


def _first_look(picture: Picture, keypoint_candidates: dict[bool, Iterator[Candidate]]) -> _FirstLook:
    """Steps 1 and 2, from the keypoint candidates by whether they mirror the picture."""
    strongest = best = None
    for mirrored in (False, True):  # keypoints of a symmetric model support the wrong hand, too
        first = next(keypoint_candidates[mirrored], None)
        if first is None:
            continue
        best = _best_candidate(picture, [first], best)
        if best is not None and best.sure and not (best.settled or _explained(best)) and best.mirrored == mirrored:
            nearer = list(islice(keypoint_candidates[mirrored], 1))
            tried = _best_candidate(picture, nearer, best)
            if tried is not None and _explained(tried):
                best = tried
            else:  # the other hand first
                keypoint_candidates[mirrored] = chain(nearer, keypoint_candidates[mirrored])
        strongest = first if strongest is None or first.support > strongest.support else strongest
        if best is not None and best.settled:
            break
    look = _FirstLook(strongest, best)
    if best is None or not best.settled or look.explained:
        return look
    if best.uncovered_correlation > CONFIG.nearly_explained:
        return replace(look, full=_refine_to_full_size(picture, best))
    blur = picture.blur(best.camera, CONFIG.full_level, best.mirrored, best.settings)
    full = None if blur is None else _refine_to_full_size(picture, best)
    return replace(look, full=full) if full is not None and _explained(full) else look


def _of_subject(
    image: Float32, subject: tuple[slice, slice], config: CameraConfig, search: Callable[..., FoundCamera | None]
) -> FoundCamera | None:
    """Step 3: what `search` finds in the middle of the picture, with the lenses of the whole."""
    part = np.ascontiguousarray(image[subject])
    focals = tuple(focal * image.shape[1] / part.shape[1] for focal in config.focals)
    found = search(part, config=replace(config, focals=focals, framed=False, parts=False, uneven=False))
    return None if found is None else replace(found, frame=subject)


def _with_uneven_pixels(look: _FirstLook, picture: Picture, candidates: Candidates) -> _FirstLook:
    """Step 4: the look at a camera with pixels that are not square, where there is one."""
    proposed = candidates.uneven(look.strongest, look.best is not None and look.best.settled)
    best = None if proposed is None else _best_candidate(picture, [proposed])
    uneven = None if best is None else _refine_to_full_size(picture, best)
    return look if uneven is None else _FirstLook(proposed, best, uneven)


def _within_frame(
    look: _FirstLook,
    picture: Picture,
    candidates: Candidates,
    image: Float32,
    search: Callable[[Float32], FoundCamera | None],
) -> FoundCamera | None:
    """Step 5: what `search` finds within a frame, or the camera of the whole picture if that explains more."""
    whole = look.full
    frame = candidates.frame(look.strongest) if look.strongest is not None and look.strongest.supported else None
    if frame is None or min(image[frame].shape[:2]) < CONFIG.least_side:
        return whole
    inner = search(np.ascontiguousarray(image[frame]))
    if inner is None:
        return whole
    if whole is None and look.best is not None and not _explained(inner):
        whole = _refine_to_full_size(picture, look.best)  # the frame may be wrong
    return replace(inner, frame=frame) if whole is None or inner.gain > whole.gain else whole


def _best_candidate(
    picture: Picture, candidates: Iterable[Candidate], best: Candidate | None = None
) -> Candidate | None:
    """The candidate that explains a small picture best, refined on it; `best` is the best so far. The first that is
    settled ends the search, and no other is drawn from `candidates`."""
    if best is not None and best.settled:
        return best
    for proposed in candidates:
        tried = _refine_small(picture, proposed)
        if tried is None:
            continue
        candidate, refined = tried
        if best is None and candidate.settled:  # no other to compare its score with
            return candidate
        side = candidate.side
        score = picture.score(refined, candidate.mirrored, candidate.settings)
        score *= (CONFIG.small_levels[0].side / side) ** 2
        if best is None or score > best.score:
            best = replace(candidate, score=score)
            if best.settled:
                break
    return best


def _refine_small(picture: Picture, proposed: Candidate) -> tuple[Candidate, Refined] | None:
    """A candidate refined on the smallest picture that can tell whether it is right, in either order of blending."""
    settings = proposed.settings
    # Where many keypoints agree the camera is right within a pixel, and the smallest picture would lead it astray.
    for level in CONFIG.small_levels[1:] if proposed.supported else CONFIG.small_levels:
        refined = picture.refined(proposed.camera, level, mirrored=proposed.mirrored, settings=settings)
        if refined is not None and (refined.alike or not refined.hopeful):
            break
    if refined is None:
        return None
    if refined.hopeful:
        other = replace(settings, by_distance=not settings.by_distance)
        refined, settings = _with_better_settings(picture, refined, level, proposed.mirrored, settings, other)
    candidate = replace(
        proposed,
        camera=picture.full(refined.camera),
        correlation=refined.correlation,
        uncovered_correlation=refined.uncovered_correlation,
        side=level.side,
        max_error=CONFIG.error_per_step * refined.step / level.side,
        hopeful=refined.hopeful,
        settings=settings,
    )
    return candidate, refined


def _with_better_settings(
    picture: Picture,
    refined: Refined,
    level: Level,
    mirrored: bool,
    settings: RasterSettings,
    other: RasterSettings,
    blur: Blur | None = None,
) -> tuple[Refined, RasterSettings]:
    """The camera refined on renders with these settings, or with the `other` ones where that explains the picture
    clearly better; and the settings of the better. Renders are blurred as the picture is known to be."""
    camera = picture.full(refined.camera)
    max_error = CONFIG.error_per_step * refined.step / min(level.side, max(picture.size))
    attempt = partial(picture.refined, camera, mirrored=mirrored, settings=other, max_error=max_error, blur=blur)
    glance = attempt(replace(level, iterations=1))
    if glance is not None and glance.gain > CONFIG.glance_better * refined.gain:
        again = attempt(level)
        if again is not None and again.gain > CONFIG.clearly_better * refined.gain:
            return again, other
    return refined, settings


def _with_own_low_pass(
    picture: Picture, refined: Refined, level: Level, mirrored: bool, settings: RasterSettings, blur: Blur | None
) -> tuple[Refined, RasterSettings]:
    """The camera refined on renders with the low pass that the picture was drawn with, and their settings: half of it
    and less where the picture was reduced since (a screenshot of a display with small pixels), twice and more where it
    was enlarged."""
    for factor in (0.5, 2.0):
        better = settings
        while True:
            other = replace(better, eps2d=factor * better.eps2d)
            refined, chosen = _with_better_settings(picture, refined, level, mirrored, better, other, blur)
            if chosen is better:
                break
            better = chosen
        if better is not settings:
            break
    return refined, better


def _explained(camera: Candidate | FoundCamera) -> bool:
    """Whether nothing is left for another shape of pixels, or a frame, to explain."""
    least = CONFIG.explained if is_square(camera.camera) else CONFIG.explained_uncovered
    return camera.uncovered_correlation >= CONFIG.explained_uncovered and camera.correlation >= least


def _refine_to_full_size(picture: Picture, candidate: Candidate) -> FoundCamera | None:
    """The camera refined level by level up to the picture's own size; None where its render does not look like the
    picture, or the small picture showed that it will not."""
    if not candidate.hopeful:
        return None
    own, full_level = max(picture.size), CONFIG.full_level
    full_side = min(own, full_level.side)
    camera, settings, max_error = candidate.camera, candidate.settings, candidate.max_error
    between = [level for level in CONFIG.small_levels if candidate.side < level.side < own]
    for level in [*between, replace(full_level, side=full_side)]:
        refined, blur = picture.refined_through_blur(
            camera, level, mirrored=candidate.mirrored, settings=settings, max_error=max_error
        )
        if refined is None or not refined.alike:
            return None
        camera, max_error = picture.full(refined.camera), CONFIG.error_per_step * refined.step / level.side
    assert refined is not None  # there is always a last level
    if refined.shift > CONFIG.free_step:  # without its principal point a camera is wrong in all else
        freed = picture.refined(
            camera, CONFIG.free_level, mirrored=candidate.mirrored, settings=settings, free=PARAMETERS, blur=blur
        )
        if freed is not None and freed.gain > CONFIG.clearly_better * refined.gain:
            refined = freed
    other = replace(settings, antialiased=not picture.model.antialiased)
    refined, settings = _with_better_settings(
        picture,
        refined,
        full_level,
        candidate.mirrored,
        settings,
        other,
        blur,  # blurred pictures look antialiased
    )
    refined, settings = _with_own_low_pass(picture, refined, full_level, candidate.mirrored, settings, blur)
    return FoundCamera(
        camera=picture.full(refined.camera),
        inliers=candidate.support,
        rms=refined.rms,
        correlation=refined.correlation,
        step=refined.step,
        gain=refined.gain * (own / full_side) ** 2,
        uncovered_correlation=refined.uncovered_correlation,
        mirrored=candidate.mirrored,
        settings=settings,
    )


_CONFIG = CONFIG.ground


def find_subject(image: Float32) -> tuple[slice, slice] | None:
    """Rows and columns around the middle of a picture (H, W, 3), 0..1, that hold all it shows on a plain ground, and a
    margin; None where the ground is not plain, or that is most of the picture."""
    import cv2

    height, width = image.shape[:2]
    factor = min(1.0, _CONFIG.side / max(height, width))
    shape = max(8, round(width * factor)), max(8, round(height * factor))
    small = cv2.resize(image, shape, interpolation=cv2.INTER_AREA)
    border = np.concatenate([small[0], small[-1], small[1:-1, 0], small[1:-1, -1]])
    ground = np.median(border, axis=0)
    if (np.abs(border - ground).max(axis=1) < _CONFIG.plain).mean() < _CONFIG.least_border:
        return None
    there = (np.abs(small - ground).max(axis=2) > _CONFIG.other).astype(np.uint8)
    joined = cv2.dilate(there, np.ones((2 * _CONFIG.joined + 1,) * 2, dtype=np.uint8))
    _, _, stats, _ = cv2.connectedComponentsWithStats(joined)
    parts = stats[1:]  # the first is the ground
    if not len(parts):
        return None
    areas = parts[:, cv2.CC_STAT_AREA]
    parts = parts[areas >= _CONFIG.least_part * areas.max()]
    low = parts[:, [cv2.CC_STAT_TOP, cv2.CC_STAT_LEFT]].min(axis=0)
    sizes = parts[:, [cv2.CC_STAT_HEIGHT, cv2.CC_STAT_WIDTH]]
    high = (parts[:, [cv2.CC_STAT_TOP, cv2.CC_STAT_LEFT]] + sizes).max(axis=0)
    margin = _CONFIG.margin * float((high - low).max())
    center = 0.5 * np.array(small.shape[:2])
    # As much on either side of the middle, so that the camera of this part looks at its middle, too.
    half = np.minimum(np.maximum(center - low, high - center) + margin, center) / center
    rows, columns = np.ceil(0.5 * half * (height, width)).astype(int).tolist()
    if 2 * max(rows, columns) > _CONFIG.most * max(height, width) or 2 * min(rows, columns) < CONFIG.least_side:
        return None
    middle = height // 2, width // 2
    return slice(middle[0] - rows, height - middle[0] + rows), slice(middle[1] - columns, width - middle[1] + columns)
