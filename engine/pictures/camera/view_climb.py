"""Hill climbing from about the right view to the right one: small renders of neighboring cameras are scored, and the
best replaces the camera, in ever smaller steps (DESIGN 4.8).

A search over views ends ten to thirty degrees off, from where neither keypoints nor a refinement by brightness
converges. Outlines, edges and colors change with every step; most starts are dropped on the way.

Nothing here sees a key or a chip.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy

from engine.kernels.jit import side_by_side
from engine.model import Camera, GaussianModel
from engine.pictures.camera.camera_motion import farther
from engine.pictures.camera.config import CONFIG, ClimbRound
from engine.pictures.camera.picture_edges import PictureEdges
from engine.pictures.camera.view_points import ViewPoints, describe_view


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
    for round_ in CONFIG.edges.rounds:
        moved = side_by_side(partial(_step, model, pictures, round_), climbing)
        climbing = _distinct([step for step in moved if step is not None], round_.kept)
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


def _distinct(found: Sequence[Climbed], count: int) -> list[Climbed]:
    """The best, none of which is nearly a better one."""
    chosen: list[Climbed] = []
    for each in sorted(found, key=lambda one: -one.score):
        if len(chosen) == count:
            break
        rivals = (other.camera for other in chosen if other.picture == each.picture)
        if all(_turned(rival, each.camera) >= CONFIG.edges.same_direction for rival in rivals):
            chosen.append(each)
    return chosen


def _turned(a: Camera, b: Camera) -> float:
    """The angle between two cameras' directions, roll included, radians."""
    return float(scipy.spatial.transform.Rotation.from_matrix(a.viewmat[:3, :3] @ b.viewmat[:3, :3].T).magnitude())
