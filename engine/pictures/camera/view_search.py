"""Where no keypoint helps: a picture held against outlines, edges and colours of many views of a model, all rolls,
sizes and places at once (DESIGN 4.8).

A view is a few dozen points on its silhouette and on the edges inside, each with the direction of its edge, as in
LINE-2D (Hinterstoisser et al. 2012, "Gradient Response Maps"), and colours within it. A place scores what the picture's
edges say there, in standard deviations of what they say anywhere; the best are scored again with colors, and become
cameras.

Nothing here sees a key or a chip.
"""

from collections.abc import Sequence

import numpy as np

from engine.model import Camera, Float32, Float64, Int64
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.picture_edges import PictureEdges, stacked
from engine.pictures.camera.view_points import ViewPoints
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
    shape = np.array(picture.small.shape[:2])

    def best_places(maps: Float32, points: slice, jobs: Int64) -> tuple[Float32, Int64]:
        scores, found = np.empty(len(jobs), dtype=np.float32), np.empty((len(jobs), 2), dtype=np.int64)
        where, along = (np.ascontiguousarray(each[:, points]) for each in (edges, directions))
        score_views(maps, where, along, jobs, sizes, shape, scores, found)
        return scores, found

    maps, coarse = picture.maps
    jobs = np.indices((len(views), ROLLS, len(radii))).reshape(3, -1).T.copy()
    glance, _ = best_places(coarse, slice(None, None, 2), jobs)
    jobs = jobs[np.argsort(-glance, kind="stable")[: max(_CONFIG.rescored, int(_CONFIG.promising * len(jobs)))]]
    scores, found = best_places(maps, slice(None), jobs)
    ranked = np.argsort(-scores, kind="stable")[: _CONFIG.rescored]
    finds, found = jobs[ranked], found[ranked]
    turns = finds[:, 1] * (2.0 * np.pi / ROLLS)
    starts = np.stack([turns, sizes[finds[:, 2]].astype(np.float64), *found.T], axis=1)
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
        alike = (turned < _CONFIG.same_roll) & (size < _CONFIG.same_size * poses[find, 1])
        alike &= np.maximum(x, y) < _CONFIG.same_place
        if not alike.any():
            chosen.append(int(find))
    return chosen
