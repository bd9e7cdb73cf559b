"""The landmark bank: keypoints of regular views of the reference, lifted to 3-D (DESIGN 4.8).

It is made once, at embedding, and kept in the owner's record, so that finding the camera of a screenshot renders
nothing but the view it is closing in on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Bool, Camera, Float32, GaussianModel, Int32
from engine.raster import render_depth
from engine.watermark.features import detect_keypoints, luma

__all__ = ["Landmarks", "LandmarksConfig", "make_landmarks"]


@dataclass(frozen=True)
class LandmarksConfig:
    """Knobs of `make_landmarks`.

    Parameters
    ----------
    per_view : int
        Keypoints kept of a view, the strongest; a landmark takes 144 bytes.
    least_alpha : float
        Smallest opacity of the picture around a keypoint: what lies there is solid.
    depth_range : float
        Largest relative spread of depth around a keypoint; more is an edge, where depth means nothing.
    margin : int
        Radius of "around", pixels.
    """

    per_view: int = 500
    least_alpha: float = 0.8
    depth_range: float = 0.05
    margin: int = 3


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Points of the reference's surface and what they look like, view by view.

    Parameters
    ----------
    points : (L, 3) float32
        World coordinates.
    descriptors : (L, 128) uint8
        RootSIFT in eight bits.
    views : (L,) int32
        Index of the view in which the landmark was seen, ascending.
    """

    points: Float32
    descriptors: npt.NDArray[np.uint8]
    views: Int32

    def __post_init__(self) -> None:
        count = len(self.points)
        if (
            self.points.shape != (count, 3)
            or self.descriptors.shape != (count, 128)
            or self.views.shape != (count,)
        ):
            raise InputError(
                f"landmarks do not belong together: {self.points.shape}, {self.descriptors.shape}, "
                f"{self.views.shape}"
            )
        if count and np.any(np.diff(self.views) < 0):
            raise InputError("landmarks must be sorted by view")

    def __len__(self) -> int:
        return len(self.points)

    @property
    def nbytes(self) -> int:
        """Size in a record, bytes, before compression."""
        return self.points.nbytes + self.descriptors.nbytes + self.views.nbytes


def make_landmarks(
    model: GaussianModel,
    cameras: Sequence[Camera],
    advance: Callable[[float], Any] | None = None,
    config: LandmarksConfig = LandmarksConfig(),
) -> Landmarks:
    """Render the views and lift their keypoints.

    Parameters
    ----------
    model : GaussianModel
        The unmarked reference.
    cameras : sequence of Camera
        About 48 views of roughly 512 to 640 pixels, from all sides a screenshot may come from.
    advance : callable, optional
        Called with the share done, 0..1, after each view.
    config : LandmarksConfig

    Returns
    -------
    Landmarks
        At most `per_view` a camera; none where nothing solid is seen.
    """
    points, descriptors, views = [], [], []
    for number, camera in enumerate(cameras):
        image, alpha, depth = render_depth(model, camera)
        solid = _solid(alpha, depth, config)
        keypoints = detect_keypoints(luma(image), 4 * config.per_view, mask=solid)
        column, row = keypoints.points.astype(np.int64).T
        keep = np.nonzero(solid[np.clip(row, 0, camera.height - 1), np.clip(column, 0, camera.width - 1)])[0][
            : config.per_view
        ]
        pixels = np.concatenate([keypoints.points[keep], np.ones((len(keep), 1))], axis=1)
        rays = pixels @ np.linalg.inv(camera.K).T  # (M, 3), z = 1
        in_camera = rays * depth[row[keep], column[keep]].astype(np.float64)[:, None]
        points.append((in_camera - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3])
        descriptors.append(keypoints.descriptors[keep])
        views.append(np.full(len(keep), number, dtype=np.int32))
        if advance is not None:
            advance((number + 1) / len(cameras))
    if not points:
        return Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.int32))
    return Landmarks(
        np.concatenate(points).astype(np.float32), np.concatenate(descriptors), np.concatenate(views)
    )


def _solid(alpha: Float32, depth: Float32, config: LandmarksConfig) -> Bool:
    """Pixels around which the picture is opaque and depth is smooth."""
    import cv2

    size = 2 * config.margin + 1
    window = np.ones((size, size), dtype=np.uint8)
    opaque = cv2.erode(alpha, window, borderType=cv2.BORDER_REPLICATE) > config.least_alpha
    nearest, farthest = cv2.erode(depth, window), cv2.dilate(depth, window)
    return np.asarray(opaque & (farthest - nearest < config.depth_range * np.maximum(nearest, 1e-9)))
