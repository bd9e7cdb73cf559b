"""Where no keypoint helps: a picture held against outlines, edges and colours of many views of a model, all rolls,
sizes and places at once (DESIGN 4.8).

A view is a few dozen points on its silhouette and on the edges inside, each with the direction of its edge, as in
LINE-2D (Hinterstoisser et al. 2012, "Gradient Response Maps"), and colours within it. A place scores what the picture's
edges say there, in standard deviations of what they say anywhere; the best are scored again with colors, and become
cameras.

That ends ten to thirty degrees off, from where neither keypoints nor a refinement by brightness converges. So the best
climb: small renders of neighboring cameras are scored, and the best replaces the camera, in ever smaller steps. Most
starts are dropped on the way.

Nothing here sees a key or a chip.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy

from engine.kernels.jit import side_by_side
from engine.model import Camera, Float32, Float64, GaussianModel, Int64
from engine.pictures.camera.camera_motion import farther
from engine.pictures.camera.config import CONFIG, ClimbRound
from engine.pictures.camera.picture_edges import PictureEdges, stacked
from engine.pictures.camera.view_points import ViewPoints, describe_view
from engine.pictures.camera.view_scores import ROLLS, score_views

_CONFIG = CONFIG.edges


def search_views(
    views: Sequence[ViewPoints], picture: PictureEdges, count: int, radii: tuple[float, ...] = _CONFIG.radii
) -> list[tuple[float, Camera]]:
    """The `count` best cameras of the small picture, each with its score, by falling score; `radii` are the sizes
    tried.

    A camera stands where the view's stood, with a lens to make the size right.
    """
    if not views:
        return []
    edges, directions, sizes = stacked(views, "edges"), stacked(views, "directions"), np.array(radii, dtype=np.float32)
    jobs = np.indices((len(views), ROLLS, len(radii))).reshape(3, -1).T.copy()
    scores, found = np.empty(len(jobs), dtype=np.float32), np.empty((len(jobs), 2), dtype=np.int64)
    few, their = (np.ascontiguousarray(each[:, ::2]) for each in (edges, directions))
    score_views(picture.maps, few, their, jobs, sizes, np.array(picture.small.shape[:2]), scores, found)
    ranked = np.argsort(-scores, kind="stable")[: _CONFIG.promising]
    finds, found = jobs[ranked], found[ranked]
    turns = finds[:, 1] * (2.0 * np.pi / ROLLS)
    starts = np.stack([turns, sizes[finds[:, 2]].astype(np.float64), *found.T], axis=1)
    edges_fit = picture.placed(views, finds[:, 0], starts, 0)[:, 4]
    best = np.argsort(-edges_fit, kind="stable")[: _CONFIG.rescored]
    finds = finds[best]
    fine, poses = picture.scored(views, finds[:, 0], starts[best])
    chosen = _distinct(finds[:, 0], poses, fine, count)
    return [(float(fine[k]), picture.camera(views[finds[k, 0]], poses[k])) for k in chosen]


def _distinct(views: Int64, poses: Float64, scores: Float32, count: int) -> list[int]:
    """The best finds, none of which is nearly a better one: of one view, and alike in roll, size and place."""
    chosen: list[int] = []
    for find in np.argsort(-scores, kind="stable"):
        if len(chosen) == count:
            break
        others = [other for other in chosen if views[other] == views[find]]
        turned, size, x, y = (np.abs(poses[find] - poses[others])).T
        turned = np.minimum(turned, 2.0 * np.pi - turned)
        alike = (turned < _CONFIG.same_roll) & (size < _CONFIG.same_size * poses[find, 1])
        alike &= np.maximum(x, y) < _CONFIG.same_place
        if not alike.any():
            chosen.append(int(find))
    return chosen


@dataclass(frozen=True, eq=False)
class Climbed:
    """A camera of the small picture, how well it fits, and which of the pictures that is."""

    score: float
    camera: Camera
    picture: int


def climb(model: GaussianModel, pictures: Sequence[PictureEdges], starts: Sequence[Climbed]) -> list[Climbed]:
    """The best cameras reached from the starts, by falling score.

    `model` is merged for small renders; `pictures` are a picture and its mirror image, which the starts index.
    """
    climbing = list(starts)
    for round_ in _CONFIG.rounds:
        moved = side_by_side(partial(_step, model, pictures, round_), climbing)
        climbing = _best_apart([step for step in moved if step is not None], round_.kept)
    return climbing


def _step(model: GaussianModel, pictures: Sequence[PictureEdges], round_: ClimbRound, start: Climbed) -> Climbed | None:
    """The best camera near the start's, itself among them; None where nothing is seen from it."""
    here = describe_view(model, start.camera)
    if here is None:
        return None
    near = [view for camera in _around(here, round_) if (view := describe_view(model, camera)) is not None]
    views, picture = [here, *near], pictures[start.picture]
    poses = np.array([(0.0, view.spread, *(view.middle - 0.5)) for view in views])
    scores, poses = picture.scored(views, np.arange(len(views)), poses)
    best = int(scores.argmax())
    return Climbed(float(scores[best]), picture.camera(views[best], poses[best]), start.picture)


def _around(view: ViewPoints, round_: ClimbRound) -> Iterator[Camera]:
    """Cameras a step up, down, left and right of a view's, around what it shows; nearer and farther, other lenses."""
    camera, angle = view.camera, np.radians(round_.degrees)
    pivot = view.depth * np.linalg.solve(camera.K, np.array([*view.middle, 1.0]))
    for turn in ((angle, 0.0, 0.0), (-angle, 0.0, 0.0), (0.0, angle, 0.0), (0.0, -angle, 0.0)):
        motion = np.eye(4)
        motion[:3, :3] = scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix()
        motion[:3, 3] = pivot - motion[:3, :3] @ pivot
        yield Camera(motion @ camera.viewmat, camera.K, camera.width, camera.height)
    for factor in round_.distances:
        yield farther(camera, view.depth, factor)


def _best_apart(found: Sequence[Climbed], count: int) -> list[Climbed]:
    """The best, none of which is nearly a better one."""
    chosen: list[Climbed] = []
    for each in sorted(found, key=lambda one: -one.score):
        if len(chosen) == count:
            break
        rivals = (other.camera for other in chosen if other.picture == each.picture)
        if all(_turned(rival, each.camera) >= _CONFIG.same_direction for rival in rivals):
            chosen.append(each)
    return chosen


def _turned(a: Camera, b: Camera) -> float:
    """The angle between two cameras' directions, roll included, radians."""
    return float(scipy.spatial.transform.Rotation.from_matrix(a.viewmat[:3, :3] @ b.viewmat[:3, :3].T).magnitude())
