"""Which landmark does each keypoint of a picture show?

Before a camera is known, by Lowe's ratio test. A place seen in several views is in the bank several times, so
its copies must not fail the test against each other: over the whole bank the rival of the best match is the best
match *elsewhere*, and in the few views that look most like the picture the test runs within the view. Once a
camera is roughly known, by where the landmarks project.
"""

# mypy: allow-untyped-defs

import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.model import Camera, Float32, Float64, Int64
from engine.numerics.tables import first_at_least
from engine.pictures.camera.camera_motion import project
from engine.pictures.landmarks.config import CONFIG
from engine.pictures.landmarks.keypoints import Keypoints
from engine.pictures.landmarks.landmark_set import Landmarks

_UNLIKE = 1 << 30  # a distance, squared, that no two descriptors have


@inlined
def _two_nearest(products, squares, k, begin, end):
    """Nearest landmark of [begin, end) to keypoint k, its distance, and the second least distance."""
    place, low, high = begin, np.float32(np.inf), np.float32(np.inf)
    for n in range(begin, end):
        d = squares[n] - np.float32(2.0) * products[k, n]
        if d < high:
            if d < low:
                place, low, high = n, d, low
            else:
                high = d
    return place, low, high


@parallel_kernel
def _rank(products, squares, points, starts, radius, best, first, rival, in_view, call):
    """For each row: best landmark, its distance, the best distance elsewhere; and by view the best two."""
    for k in share_of(products.shape[0], call):
        nearest, distance = 0, np.float32(np.inf)
        for v in range(len(starts) - 1):
            place, low, high = _two_nearest(products, squares, k, starts[v], starts[v + 1])
            in_view[k, v, 0], in_view[k, v, 1], in_view[k, v, 2] = place, low, high
            if low < distance:
                nearest, distance = place, low
        x, y, z = points[nearest, 0], points[nearest, 1], points[nearest, 2]
        second = np.float32(np.inf)
        for v in range(len(starts) - 1):
            if in_view[k, v, 1] >= second:
                continue
            seen = np.int64(in_view[k, v, 0])
            away = (points[seen, 0] - x) ** 2 + (points[seen, 1] - y) ** 2 + (points[seen, 2] - z) ** 2
            if away > radius * radius:
                second = np.float32(in_view[k, v, 1])
                continue
            for n in range(starts[v], starts[v + 1]):  # a view of the same place: what it shows elsewhere
                d = squares[n] - np.float32(2.0) * products[k, n]
                if d < second:
                    away = (points[n, 0] - x) ** 2 + (points[n, 1] - y) ** 2 + (points[n, 2] - z) ** 2
                    if away > radius * radius:
                        second = d
        best[k], first[k], rival[k] = nearest, distance, second


@parallel_kernel
def _nearest_look(pixels, descriptors, places, rows, order, targets, radius, best, distance, call):
    """Of each keypoint, the target that looks most like it among those whose place is near; `order` is theirs from top
    to bottom, `rows` the y of that order."""
    for k in share_of(len(pixels), call):
        x, y = pixels[k, 0], pixels[k, 1]
        nearest, low = np.int64(-1), np.int32(_UNLIKE)
        for place in range(first_at_least(rows, y - radius), first_at_least(rows, y + radius)):
            n = order[place]
            if abs(places[n, 0] - x) < radius and abs(places[n, 1] - y) < radius:
                total = np.int32(0)
                for c in range(128):
                    off = np.int32(descriptors[k, c]) - np.int32(targets[n, c])
                    total += off * off
                if total < low or (total == low and n < nearest):
                    nearest, low = n, total
        best[k], distance[k] = nearest, low


def match_landmarks(
    keypoints: Keypoints, landmarks: Landmarks, ratios: tuple[float, float], radius: float, views: int
) -> list[tuple[Int64, Int64]]:
    """Match keypoints to landmarks by how they look: indices (M,), (M,) of those that stand out in the whole bank; then
    those too that stand out in their view, with which a keypoint may match several landmarks.

    `ratios`, 0..1, are the largest accepted of the distances to best match and rival, over the bank and within a view.
    Landmarks nearer than `radius` (scene units) to the best match are the same place. Matches are sought separately in
    so many `views`: those with most.
    """
    none = np.zeros(0, dtype=np.int64)
    if len(keypoints) == 0 or len(landmarks) < 2:
        return [(none, none)]
    order = np.argsort(landmarks.views, kind="stable")
    starts = np.append(np.unique(landmarks.views[order], return_index=True)[1], len(order))
    target = landmarks.descriptors[order].astype(np.float32)  # (L, 128)
    squares = np.einsum("ij,ij->i", target, target)
    points = np.ascontiguousarray(landmarks.points[order], dtype=np.float32)
    count = len(keypoints)
    best = np.empty(count, dtype=np.int64)
    first, rival = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
    in_view = np.empty((count, len(starts) - 1, 3))
    query: Float32 = keypoints.descriptors.astype(np.float32)
    for low in range(0, count, CONFIG.chunk):
        part = slice(low, low + CONFIG.chunk)
        products = query[part] @ target.T  # exact: sums of integers below 2^24
        _rank(
            products, squares, points, starts, np.float32(radius), best[part], first[part], rival[part], in_view[part]
        )
    own = np.einsum("ij,ij->i", query, query)
    everywhere = np.nonzero(first + own < ratios[0] ** 2 * (rival + own))[0]
    sure = in_view[..., 1] + own[:, None] < ratios[1] ** 2 * (in_view[..., 2] + own[:, None])  # (P, V)
    likely = np.argsort(-sure.sum(axis=0), kind="stable")[:views]
    row, column = np.nonzero(sure[:, likely])
    sparse = np.stack([everywhere, best[everywhere]], axis=1)  # (M, 2)
    dense = np.stack([row, in_view[row, likely[column], 0].astype(np.int64)], axis=1)  # (M, 2)
    dense = np.unique(np.concatenate([sparse, dense]), axis=0)
    return [(pairs[:, 0], order[pairs[:, 1]].astype(np.int64)) for pairs in (sparse, dense)]


def match_projected(keypoints: Keypoints, landmarks: Landmarks, camera: Camera, radius: float) -> tuple[Int64, Int64]:
    """Match keypoints to the landmark that looks most like them among those a roughly right camera projects near them.

    `radius` is the farthest in x and in y, pixels. Indices (M,), (M,) by rising keypoint, each at most once.
    """
    places = project(landmarks.points.astype(np.float64), camera)
    size: Float64 = np.array([camera.width, camera.height], dtype=np.float64)
    inside = np.nonzero(((places > -radius) & (places < size + radius)).all(axis=1))[0]
    order = np.argsort(places[inside, 1], kind="stable")
    best = np.empty(len(keypoints), dtype=np.int64)
    distance = np.empty(len(keypoints), dtype=np.int64)
    _nearest_look(
        keypoints.points,
        keypoints.descriptors,
        places[inside],
        places[inside[order], 1],
        order,
        landmarks.descriptors[inside],
        radius,
        best,
        distance,
    )
    alike = np.nonzero((best >= 0) & (distance < CONFIG.most_unlike**2))[0]
    return alike, inside[best[alike]].astype(np.int64)
