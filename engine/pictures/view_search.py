"""Where no keypoint helps: a picture held against outlines, edges and colours of many views of a model, all rolls,
sizes and places at once (DESIGN 4.8).

A view is a few dozen points on its silhouette and on the edges inside, each with the direction of its edge, as in
LINE-2D (Hinterstoisser et al. 2012, "Gradient Response Maps"), and colours within it. A place scores what the picture's
edges say there, in standard deviations of what they say anywhere; the best are looked at again, colours and all. They
become cameras, to be made better by those who ask.

Nothing here sees a key or a chip.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from engine.model import Camera, Float32, Float64, GaussianModel, Int64
from engine.numerics.jit import parallel_section
from engine.pictures.camera_motion import farther, swung
from engine.pictures.picture_edges import PictureEdges, stacked
from engine.pictures.view_points import ViewPoints, describe_view
from engine.pictures.view_scores import ROLLS, SIDE, score_views

__all__ = ["LARGE", "RADII", "describe_parts", "describe_views", "search_views"]

RADII = tuple(0.125 * SIDE * 1.25**k for k in range(11))
"""Sizes tried: how far, root mean square, the points lie from their middle, pixels."""
LARGE = RADII[4:]
"""Those of a part that fills a picture."""
AGAIN = 1500
"""Finds that are looked at again, in finer steps of roll, size and place."""
NEAR = 0.5
"""The distance, in that of the views given, from which they are taken again: through a wide lens what is near has
another shape, to which no search from afar leads (of five pictures that were missed two are found)."""
PARTS, NEARER = 3, 0.35
"""Places of a view, as far from each other as can be, at which a camera so much nearer is aimed: close-ups whose middle
is elsewhere (of eleven that were missed two are found; at six places one more, for twice the time)."""
_SAME_ROLL, _SAME_SIZE, _SAME_PLACE = np.radians(18.0), 0.25, 6.0
"""Radians, share of the size, and pixels within which two finds of a view are one."""


def describe_views(model: GaussianModel, cameras: Sequence[Camera]) -> list[ViewPoints]:
    """Points of renders from these cameras, reduced to `SIDE` pixels, and from `NEAR`; views without edges are left
    out."""
    away = _described(model, (camera.with_side(SIDE) for camera in cameras))
    return [*away, *_described(model, (farther(view.camera, view.depth, NEAR) for view in away))]


def describe_parts(model: GaussianModel, cameras: Sequence[Camera]) -> list[ViewPoints]:
    """Points of renders from `NEARER` than these cameras, each aimed at `PARTS` places of what its camera sees."""
    away = _described(model, (camera.with_side(SIDE) for camera in cameras))
    return _described(model, (_aimed(view, place) for view in away for place in _places(view)))


def _described(model: GaussianModel, cameras: Iterable[Camera]) -> list[ViewPoints]:
    return [view for camera in cameras if (view := describe_view(model, camera)) is not None]


def _places(view: ViewPoints) -> Float64:
    """(PARTS, 2) of a view's inner points, pixels, that lie far from each other."""
    places = view.inner * view.spread + view.middle
    away = np.square(places - places.mean(axis=0)).sum(axis=1)
    chosen: list[int] = []
    for _ in range(PARTS):
        chosen.append(int(away.argmax()))
        apart = np.square(places - places[chosen[-1]]).sum(axis=1)
        away = apart if len(chosen) == 1 else np.minimum(away, apart)
    return places[chosen]


def _aimed(view: ViewPoints, place: Float64) -> Camera:
    camera = view.camera
    shape = camera.height, camera.width
    return farther(swung(camera, place, np.array(shape[::-1]) / 2.0, 0.0, 1.0, shape), view.depth, NEARER)


def search_views(
    views: Sequence[ViewPoints], picture: PictureEdges, count: int, radii: tuple[float, ...] = RADII
) -> list[tuple[float, Camera]]:
    """The `count` best cameras of the small picture, each with its score, by falling score; `radii` are the sizes
    tried.

    A camera stands where the view's stood, with a lens to make the size right.
    """
    if not views:
        return []
    shape = len(views), ROLLS, len(radii)
    scores, found = np.empty(shape, dtype=np.float32), np.empty((*shape, 2), dtype=np.int64)
    with parallel_section():
        score_views(
            picture.maps,
            stacked(views, "edges"),
            stacked(views, "directions"),
            np.array(radii, dtype=np.float32),
            np.array(picture.small.shape[:2]),
            scores,
            found,
        )
    ranked = np.argsort(-scores, axis=None, kind="stable")[:AGAIN]
    finds = np.stack(np.unravel_index(ranked, scores.shape), axis=1)  # (F, 3)
    turns, sizes = finds[:, 1] * (2.0 * np.pi / ROLLS), np.array(radii)[finds[:, 2]]
    starts = np.stack([turns, sizes, *found[tuple(finds.T)].T], axis=1)
    fine, poses = picture.scored(views, finds[:, 0], starts)
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
        alike = (turned < _SAME_ROLL) & (size < _SAME_SIZE * poses[find, 1]) & (np.maximum(x, y) < _SAME_PLACE)
        if not alike.any():
            chosen.append(int(find))
    return chosen
