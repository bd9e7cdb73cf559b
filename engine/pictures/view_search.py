"""Where no keypoint helps: a picture held against outlines and edges of many views of a model, all rolls, sizes and
places at once (DESIGN 4.8).

A view is a few dozen points on its silhouette and on the edges inside, each with the direction of its edge, as in
LINE-2D (Hinterstoisser et al. 2012, "Gradient Response Maps"). Directions count without their sign, so neither what
lies behind the model nor the tone curve of the viewer matters. A place scores what the picture's edges say there, in
standard deviations of what they say anywhere. The best become cameras, to be refined by those who ask.

Nothing here sees a key or a chip.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.model import Bool, Camera, Float32, Float64, GaussianModel, Int64
from engine.numerics.jit import parallel_section
from engine.numerics.resampling import smooth
from engine.pictures.camera_motion import swung
from engine.pictures.view_scores import BINS, PAD, ROLLS, SIDE, look_again, score_views
from engine.raster import render_depth

__all__ = ["MOST_SEEN", "ViewEdges", "describe_views", "search_views", "thinned"]

POINTS = 72
"""Points of a view: half on its silhouette, half inside."""
APART = 2.0
"""Least distance of two points of a view, pixels."""
REACH, NEAR_REACH = 2, 1
"""Pixels an edge may be off, in the search, and when the best of it are looked at again."""
RADII = tuple(0.125 * SIDE * 1.25**k for k in range(11))
"""Sizes tried: how far, root mean square, the points lie from their middle, pixels."""
LARGER = np.float32(0.3)
"""Power of the size by which a find counts more: a small view finds edges that fit in any large one."""
AGAIN = 1500
"""Finds that are looked at again, in finer steps of roll, size and place."""
_SAME_ROLL, _SAME_SIZE, _SAME_PLACE = np.radians(18.0), 0.25, 6.0
"""Radians, share of the size, and pixels within which two finds of a view are one."""

MOST_SEEN = 30_000
"""Gaussians that are enough to look at a model from afar."""


@dataclass(frozen=True, eq=False)
class ViewEdges:
    """Edge points of V views, P each: places from their middle in units of their spread, and directions."""

    cameras: tuple[Camera, ...]
    places: Float32  # (V, P, 2) x, y
    directions: Float32  # (V, P) of the gradient, radians
    middles: Float64  # (V, 2) of the points, pixels of the camera
    spreads: Float64  # (V,) root mean square distance from there, pixels of the camera


def describe_views(model: GaussianModel, cameras: Sequence[Camera]) -> ViewEdges:
    """Edge points of renders from these cameras, reduced to `SIDE` pixels; views without edges are left out."""
    kept, places, directions, middles, spreads = [], [], [], [], []
    for camera in (camera.with_side(SIDE) for camera in cameras):
        image, alpha, _ = render_depth(model, camera)
        points, turns = _edge_points(np.clip(image, 0.0, 1.0), alpha)
        if len(points) < POINTS // 2:
            continue
        middle = points.mean(axis=0)
        spread = float(np.sqrt(np.square(points - middle).sum(axis=1).mean()))
        filled = np.arange(POINTS) % len(points)  # few points are asked twice
        kept.append(camera)
        places.append(((points - middle) / spread)[filled])
        directions.append(turns[filled])
        middles.append(middle)
        spreads.append(spread)
    count = len(kept)
    return ViewEdges(
        tuple(kept),
        np.array(places, dtype=np.float32).reshape(count, POINTS, 2),
        np.array(directions, dtype=np.float32).reshape(count, POINTS),
        np.array(middles, dtype=np.float64).reshape(count, 2),
        np.array(spreads, dtype=np.float64),
    )


def thinned(model: GaussianModel, count: int) -> GaussianModel:
    """About what the model looks like from afar: its `count` most visible Gaussians, grown to cover what all did."""
    if len(model) <= count:
        return model
    log_area = np.sort(model.log_scales.astype(np.float64), axis=1)[:, 1:].sum(axis=1)
    area = model.opacities * np.exp(np.minimum(log_area, np.quantile(log_area, 0.99)))
    kept = np.sort(np.argsort(-area, kind="stable")[:count])
    growth = np.float32(0.5 * np.log(area.sum() / area[kept].sum()))
    few = model.take(kept)
    return few.with_(log_scales=few.log_scales + growth)


def search_views(edges: ViewEdges, picture: Float32, count: int) -> list[tuple[float, Camera]]:
    """The `count` best cameras of the picture's size, each with its score, by falling score.

    `picture` is (H, W, 3), 0..1. A camera stands where the view's stood, with a lens to make the size right.
    """
    if not edges.cameras:
        return []
    small, factor = _reduced(picture)
    maps, _ = _responses(small, REACH)
    shape = len(edges.cameras), ROLLS, len(RADII)
    scores, found = np.empty(shape, dtype=np.float32), np.empty((*shape, 2), dtype=np.int64)
    with parallel_section():
        score_views(
            maps,
            edges.places,
            edges.directions,
            np.array(RADII, dtype=np.float32),
            np.array(small.shape[:2]),
            scores,
            found,
        )
    ranked = np.argsort(-scores, axis=None, kind="stable")[:AGAIN]
    finds = np.stack(np.unravel_index(ranked, scores.shape), axis=1)  # (F, 3)
    turns, radii = finds[:, 1] * (2.0 * np.pi / ROLLS), np.array(RADII)[finds[:, 2]]
    starts = np.stack([turns, radii, *found[tuple(finds.T)].T], axis=1)
    fine, poses = np.empty(len(finds), dtype=np.float32), np.zeros((len(finds), 4))
    sharp, within = _whole(*_responses(small, NEAR_REACH))
    with parallel_section():
        look_again(sharp, within, edges.places, edges.directions, finds[:, 0], starts, fine, poses)
    fine *= (poses[:, 1] / SIDE).astype(np.float32) ** LARGER
    cameras = []
    for best in _distinct(finds[:, 0], poses, fine, count):
        view, (turn, radius, x, y) = finds[best, 0], poses[best]
        scale = radius * factor / edges.spreads[view]
        place = (np.array([x, y]) + 0.5) * factor
        camera = swung(edges.cameras[view], edges.middles[view], place, turn, scale, picture.shape)
        cameras.append((float(fine[best]), camera))
    return cameras


def _edge_points(image: Float32, alpha: Float32) -> tuple[Float64, Float32]:
    """Points (P, 2), at most `POINTS`, and the directions of their gradients (P,)."""
    import cv2

    solid = cv2.erode(alpha, np.ones((5, 5), dtype=np.uint8)) > 0.7
    outline, outline_turns = _gradient(alpha[..., None])
    within, within_turns = _gradient(image)
    chosen = _apart(outline * (outline > 0.1), POINTS // 2, np.zeros(alpha.shape, dtype=np.bool_))
    near = np.zeros(alpha.shape, dtype=np.bool_)
    if len(chosen):
        near[chosen[:, 1], chosen[:, 0]] = True
    more = _apart(within * solid * (within > 0.01), POINTS - len(chosen), near)
    turns = np.concatenate([outline_turns[chosen[:, 1], chosen[:, 0]], within_turns[more[:, 1], more[:, 0]]])
    return np.concatenate([chosen, more]).astype(np.float64) + 0.5, turns.astype(np.float32)


def _apart(strength: Float32, count: int, taken: Bool) -> np.ndarray:
    """(P, 2) x, y of the strongest pixels that lie `APART` from each other and from those taken."""
    import cv2

    free = cv2.dilate(taken.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) == 0
    order = np.argsort(-strength.ravel(), kind="stable")
    chosen: list[tuple[int, int]] = []
    width = strength.shape[1]
    for index in order[: 20 * count]:
        row, column = divmod(int(index), width)
        if strength[row, column] <= 0 or len(chosen) == count:
            break
        if free[row, column]:
            chosen.append((column, row))
            reach = int(APART)
            free[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1] = False
    return np.array(chosen, dtype=np.int64).reshape(-1, 2)


def _gradient(image: Float32) -> tuple[Float32, Float32]:
    """(H, W) size and direction of the steepest channel's gradient of an image (H, W, C)."""
    gy, gx = np.gradient(smooth(image, 1.0).reshape(image.shape), axis=(0, 1))
    size = gx * gx + gy * gy
    best = size.argmax(axis=2)[..., None]
    gx, gy, size = (np.take_along_axis(each, best, axis=2)[..., 0] for each in (gx, gy, size))
    return np.sqrt(size).astype(np.float32), np.arctan2(gy, gx).astype(np.float32)


def _reduced(picture: Float32) -> tuple[Float32, float]:
    """The picture with `SIDE` pixels along its longer side, and how many of its own are one of these."""
    import cv2

    height, width = picture.shape[:2]
    factor = max(height, width) / SIDE
    shape = max(8, round(width / factor)), max(8, round(height / factor))
    return np.asarray(cv2.resize(picture, shape, interpolation=cv2.INTER_AREA), dtype=np.float32), factor


def _responses(picture: Float32, reach: int) -> tuple[Float32, Float32]:
    """What the picture says for each direction of an edge at each place, and 1 inside it: (BINS, 2, 2, h, w) and (2, 2,
    h, w), the odd and even rows and columns apart, padded by `PAD` pixels."""
    import cv2

    size, turns = _gradient(picture)
    weight = size / (size + 0.5 * np.quantile(size, 0.8) + 0.004)
    height, width = size.shape
    padded = np.zeros((BINS + 1, height + height % 2 + 2 * PAD, width + width % 2 + 2 * PAD), dtype=np.float32)
    inner = (slice(PAD, PAD + height), slice(PAD, PAD + width))
    window = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
    for b in range(BINS):
        alike = np.maximum(np.cos(2.0 * (turns - np.pi * b / BINS)), 0.0)
        spread = cv2.dilate(np.asarray(weight * alike * alike, dtype=np.float32), window)
        padded[b][inner] = (spread - spread.mean()) / max(float(spread.std()), 1e-3)
    padded[BINS][inner] = 1.0
    apart = padded.reshape(BINS + 1, padded.shape[1] // 2, 2, padded.shape[2] // 2, 2).transpose(0, 2, 4, 1, 3)
    apart = np.ascontiguousarray(apart)
    return apart[:BINS], apart[BINS]


def _whole(maps: Float32, inside: Float32) -> tuple[Float32, Float32]:
    """Responses with odd and even rows and columns together again: (BINS, h, w) and (h, w)."""
    height, width = 2 * maps.shape[3], 2 * maps.shape[4]
    whole = maps.transpose(0, 3, 1, 4, 2).reshape(BINS, height, width)
    return np.ascontiguousarray(whole), np.ascontiguousarray(inside.transpose(2, 0, 3, 1).reshape(height, width))


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
