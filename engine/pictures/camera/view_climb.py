"""From about the right view to the right one: cameras nearby are drawn, small, and the best of them is gone to, again
and again in smaller steps (DESIGN 4.8).

A search over views ends ten to thirty degrees off, from where neither keypoints nor a refinement by brightness find
home. Outlines, edges and colours change with every step; of all starts most are given up on the way.

Nothing here sees a key or a chip.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from engine.kernels.jit import side_by_side
from engine.model import Camera, GaussianModel
from engine.pictures.camera.camera_motion import farther
from engine.pictures.camera.picture_edges import PictureEdges
from engine.pictures.camera.view_points import ViewPoints, describe_view

__all__ = ["KEPT", "Climbed", "climb"]

ROUNDS = (
    (12.0, (0.4, 0.6, 1.6), 6),
    (12.0, (0.7, 1.4), 4),
    (6.0, (0.8, 1.25), 3),
    (6.0, (0.8, 1.25), 3),
    (3.0, (0.9, 1.1), 3),
    (3.0, (0.9, 1.1), 3),
)
"""Of each: degrees of a step, how much farther away others go, and how many of the cameras go on after it."""
KEPT = ROUNDS[-1][2]
"""Cameras that arrive."""
SAME = np.radians(5.0)
"""Two cameras of one hand that differ by less are one."""


@dataclass(frozen=True, eq=False)
class Climbed:
    """A camera of the small picture, how well it fits, and which of the pictures that is."""

    score: float
    camera: Camera
    picture: int


def climb(model: GaussianModel, pictures: Sequence[PictureEdges], starts: Sequence[Climbed]) -> list[Climbed]:
    """The cameras that those who start end up with, of whom few are left, by falling score.

    `model` is what is looked at, merged; `pictures` are those that the starts are of, such as one and its mirror
    image.
    """
    climbing = list(starts)
    for degrees, away, kept in ROUNDS:
        gone = side_by_side(lambda start: _step(model, pictures, start, degrees, away), climbing)  # noqa: B023
        climbing = _distinct([step for step in gone if step is not None], kept)
    return climbing


def _step(
    model: GaussianModel, pictures: Sequence[PictureEdges], start: Climbed, degrees: float, away: Sequence[float]
) -> Climbed | None:
    """The best camera near the start's, itself among them; None where nothing is seen from it."""
    here = describe_view(model, start.camera)
    if here is None:
        return None
    near = [view for camera in _around(here, degrees, away) if (view := describe_view(model, camera)) is not None]
    views, picture = [here, *near], pictures[start.picture]
    poses = np.array([(0.0, view.spread, *(view.middle - 0.5)) for view in views])
    scores, poses = picture.scored(views, np.arange(len(views)), poses)
    best = int(scores.argmax())
    return Climbed(float(scores[best]), picture.camera(views[best], poses[best]), start.picture)


def _around(view: ViewPoints, degrees: float, away: Sequence[float]) -> Iterator[Camera]:
    """Cameras a step up, down, left and right of a view's, around what it shows; nearer and farther, other lenses."""
    camera, angle = view.camera, np.radians(degrees)
    pivot = view.depth * np.linalg.solve(camera.K, np.array([*view.middle, 1.0]))
    for turn in ((angle, 0.0, 0.0), (-angle, 0.0, 0.0), (0.0, angle, 0.0), (0.0, -angle, 0.0)):
        motion = np.eye(4)
        motion[:3, :3] = scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix()
        motion[:3, 3] = pivot - motion[:3, :3] @ pivot
        yield Camera(motion @ camera.viewmat, camera.K, camera.width, camera.height)
    for factor in away:
        yield farther(camera, view.depth, factor)


def _distinct(found: Sequence[Climbed], count: int) -> list[Climbed]:
    """The best, none of which is nearly a better one."""
    chosen: list[Climbed] = []
    for each in sorted(found, key=lambda one: -one.score):
        if len(chosen) == count:
            break
        if not any(other.picture == each.picture and _turned(other.camera, each.camera) < SAME for other in chosen):
            chosen.append(each)
    return chosen


def _turned(a: Camera, b: Camera) -> float:
    """The angle between two cameras' directions, roll included, radians."""
    return float(scipy.spatial.transform.Rotation.from_matrix(a.viewmat[:3, :3] @ b.viewmat[:3, :3].T).magnitude())
