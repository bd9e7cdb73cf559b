"""What a model shows from one view, in a few dozen points: edges of its outline and within it, and colours.

Nothing here sees a key or a chip.
"""

from dataclasses import dataclass

import numpy as np

from engine.model import Bool, Camera, Float32, Float64, GaussianModel, Int64
from engine.numerics.resampling import smooth
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.view_scores import spread_out
from engine.raster import render_depth

_CONFIG = CONFIG.edges


@dataclass(frozen=True, eq=False)
class ViewPoints:
    """A view's points: places from the middle of its edges in units of their spread, (P, 2) x, y each."""

    camera: Camera
    edges: Float32  # (points, 2)
    directions: Float32  # (points,) of the gradient there, radians
    inner: Float32  # (colors, 2) places within
    colors: Float32  # (colors, 3) what is seen there, 0..1
    middle: Float64  # (2,) of the edges, pixels of the camera
    spread: float  # root mean square distance of the edges from there, pixels
    depth: float  # median, of what is solid, scene units


def describe_view(model: GaussianModel, camera: Camera) -> ViewPoints | None:
    """Points of a render from this camera, some 96 pixels wide; None where too little has an edge, or is solid."""
    import cv2

    image, alpha, depth = render_depth(model, camera)
    soft = smooth(np.minimum(image, 1.0), _CONFIG.soft)
    points, turns = _edge_points(soft, alpha)
    solid = np.flatnonzero(cv2.erode(alpha, np.ones((3, 3), dtype=np.uint8)) > _CONFIG.solid)
    if len(points) < _CONFIG.points // 2 or not len(solid):
        return None
    middle = points.mean(axis=0)
    spread = float(np.sqrt(np.square(points - middle).sum(axis=1).mean()))
    filled = np.arange(_CONFIG.points) % len(points)  # few points are repeated
    # Spread over what is solid by the golden ratio: a stride would run along a column.
    chosen = solid[(np.arange(_CONFIG.colors) * 0.618033988749895 % 1.0 * len(solid)).astype(np.int64)]
    rows, columns = np.divmod(chosen, alpha.shape[1])
    inner = np.stack([columns, rows], axis=1) + 0.5
    return ViewPoints(
        camera,
        ((points - middle) / spread)[filled].astype(np.float32),
        turns[filled],
        ((inner - middle) / spread).astype(np.float32),
        soft[rows, columns],
        middle,
        spread,
        float(np.median(depth.ravel()[solid])),
    )


def gradient(image: Float32) -> tuple[Float32, Float32, Float32]:
    """(H, W) size of the steepest channel's gradient of an image (H, W, C), and its steps down and across."""
    import cv2

    across, down = (
        cv2.split(cv2.Sobel(image, cv2.CV_32F, step, 1 - step, ksize=1, scale=0.5, borderType=cv2.BORDER_REPLICATE))
        for step in (1, 0)
    )
    gx, gy = across[0], down[0]
    size = gx * gx + gy * gy
    for x, y in zip(across[1:], down[1:], strict=True):
        other = x * x + y * y
        steeper = other > size
        for best, its in ((gx, x), (gy, y), (size, other)):
            np.copyto(best, its, where=steeper)
    return np.sqrt(size), gy, gx


def _edge_points(soft: Float32, alpha: Float32) -> tuple[Float64, Float32]:
    """Points (P, 2), at most `points`, and the directions of their gradients (P,), of a blurred image."""
    import cv2

    solid = cv2.erode(alpha, np.ones((5, 5), dtype=np.uint8)) > 0.7
    outline, *outline_steps = gradient(smooth(alpha, _CONFIG.soft)[..., None])
    within, *within_steps = gradient(soft)
    chosen = _apart(outline * (outline > 0.1), _CONFIG.points // 2, np.zeros(alpha.shape, dtype=np.bool_))
    near = np.zeros(alpha.shape, dtype=np.bool_)
    if len(chosen):
        near[chosen[:, 1], chosen[:, 0]] = True
    more = _apart(within * solid * (within > 0.01), _CONFIG.points - len(chosen), near)
    turns = [
        np.arctan2(*(step[at[:, 1], at[:, 0]] for step in steps))
        for at, steps in ((chosen, outline_steps), (more, within_steps))
    ]
    return np.concatenate([chosen, more]).astype(np.float64) + 0.5, np.concatenate(turns).astype(np.float32)


def _apart(strength: Float32, count: int, taken: Bool) -> Int64:
    """(P, 2) x, y of the strongest pixels that lie `apart` from each other and from those taken."""
    import cv2

    free = cv2.dilate(taken.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) == 0
    there, many = np.flatnonzero(strength > 0), 20 * count
    if len(there) > many:  # to sort few is cheaper
        there = np.flatnonzero(strength >= np.partition(strength.ravel(), -many)[-many])
    order = there[np.argsort(-strength.ravel()[there], kind="stable")[:many]]
    chosen: Int64 = spread_out(strength, order, count, free, _CONFIG.apart)
    return chosen
