"""Making the landmarks of a model from renders of it."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from engine.model import Bool, Camera, Float32, Float64, GaussianModel
from engine.pictures.landmarks.config import CONFIG
from engine.pictures.landmarks.keypoints import detect_keypoints, luma
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import render_depth


def make_landmarks(
    model: GaussianModel,
    cameras: Sequence[Camera],
    advance: Callable[[float], None] | None = None,
    *,
    most: int = CONFIG.per_view,
) -> Landmarks:
    """Detect landmarks in renders of the unmarked reference, in the order of the cameras, strongest first within each.

    The cameras cover it, about 48 of 640 x 480 pixels; `advance` is called with the fraction done, 0 to 1, after each.
    At most `most` of a view are kept.
    """
    found: list[Future[tuple[Float32, npt.NDArray[np.uint8]]]] = []
    with ThreadPoolExecutor(max_workers=1) as detector:  # while one picture is searched, the next is drawn
        for number, camera in enumerate(cameras):
            image, alpha, depth = render_depth(model, camera)
            if number >= CONFIG.ahead:
                found[number - CONFIG.ahead].result()
            found.append(detector.submit(_detect, image, alpha, depth, camera, most))
            if advance is not None:
                advance((number + 1) / len(cameras))
        points, descriptors = zip(*(each.result() for each in found), strict=True) if found else ((), ())
    views = [np.full(len(seen), number, dtype=np.int32) for number, seen in enumerate(points)]
    if not points:
        return Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, dtype=np.int32))
    return Landmarks(np.concatenate(points), np.concatenate(descriptors), np.concatenate(views))


def _detect(
    image: Float32, alpha: Float32, depth: Float32, camera: Camera, most: int
) -> tuple[Float32, npt.NDArray[np.uint8]]:
    """Points (P, 3) and descriptors (P, 128) of one render."""
    top, bottom, left, right = _bounds(alpha > CONFIG.least_alpha)
    gray = luma(image[top:bottom, left:right])
    if min(gray.shape) < 16:
        return np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8)
    surface = _surface(alpha, depth)  # keypoints elsewhere are not described
    keypoints = detect_keypoints(gray, CONFIG.detected, surface[top:bottom, left:right])
    pixels = keypoints.points + np.array([left, top])
    column = np.clip(pixels[:, 0].astype(np.int64), 0, camera.width - 1)
    row = np.clip(pixels[:, 1].astype(np.int64), 0, camera.height - 1)
    kept = np.nonzero(surface[row, column])[0][:most]
    z = depth[row[kept], column[kept]].astype(np.float64)
    return lift(pixels[kept], z, camera).astype(np.float32), keypoints.descriptors[kept]


def _bounds(visible: Bool) -> tuple[int, int, int, int]:
    """Top, bottom, left, right of what is visible, with a margin; detection costs by the pixel."""
    rows, columns = np.nonzero(visible.any(axis=1))[0], np.nonzero(visible.any(axis=0))[0]
    if not len(rows):
        return 0, 0, 0, 0
    return (
        max(int(rows[0]) - CONFIG.margin, 0),
        min(int(rows[-1]) + CONFIG.margin + 1, visible.shape[0]),
        max(int(columns[0]) - CONFIG.margin, 0),
        min(int(columns[-1]) + CONFIG.margin + 1, visible.shape[1]),
    )


def _surface(alpha: Float32, depth: Float32) -> Bool:
    """(H, W) where an opaque surface is seen, away from its edges."""
    import cv2

    window = np.ones((5, 5), dtype=np.uint8)
    farthest, nearest = cv2.dilate(depth, window), cv2.erode(depth, window)
    opaque = cv2.erode(alpha, window) > CONFIG.least_alpha
    return np.asarray(opaque & (farthest - nearest < CONFIG.depth_edge * depth))


def lift(pixels: Float64, depth: Float64, camera: Camera) -> Float64:
    """(P, 3) world points at pixel coordinates (P, 2) and camera depths (P,)."""
    rays = np.linalg.solve(camera.K, np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1).T).T  # (P, 3)
    local = rays * depth[:, None]
    return np.asarray((local - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3])
