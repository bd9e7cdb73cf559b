"""A picture held against renders of a model: how well a camera explains it, and the same camera made better."""

from __future__ import annotations

import numpy as np

from engine.model import Camera, Float32, GaussianModel
from engine.numerics.resampling import resized, smooth
from engine.pictures.alignment.background import fill_background
from engine.pictures.camera.camera_motion import CENTERED
from engine.pictures.camera.found_camera import OWN
from engine.pictures.camera.keypoint_cameras import look_closer
from engine.pictures.camera.pose_ransac import Hypothesis
from engine.pictures.camera.pose_refinement import Refined, refine_level
from engine.pictures.landmarks.keypoints import luma
from engine.raster import RasterSettings, render_depth

__all__ = ["Picture"]

_EDGE = 0.05
"""Steps of brightness from which an edge counts in full."""


class Picture:
    """A picture (h, w, 3), 0..1, of which a model may be seen; `mirrored` means turned over left to right."""

    def __init__(self, model: GaussianModel, image: Float32) -> None:
        self.model, self.image = model, image
        grey = luma(image)
        self.greys = (grey, np.ascontiguousarray(grey[:, ::-1]))  # as it is, and turned over
        self.size = grey.shape[1], grey.shape[0]

    def turned(self, mirrored: bool) -> Float32:
        """The picture (h, w, 3), turned over if it is mirrored."""
        return np.ascontiguousarray(self.image[:, ::-1]) if mirrored else self.image

    def closer(self, camera: Camera, mirrored: bool) -> Hypothesis | None:
        """What the picture and a render from this camera agree on."""
        return look_closer(self.model, self.greys[mirrored], camera)

    def refined(
        self,
        camera: Camera,
        mirrored: bool,
        size: int,
        iterations: int,
        step: float,
        drawn: RasterSettings = OWN,
        free: int = CENTERED,
        off: float = np.inf,
    ) -> Refined | None:
        """The camera refined on the picture reduced to this longer side; see `refine_level`. `off` is in longer sides
        of the picture."""
        grey = self.greys[mirrored]
        small = camera.with_side(min(size, max(grey.shape)))
        picture = resized(grey, small.width, small.height)
        return refine_level(
            self.model, picture, small, iterations, step, drawn, free=free, off=off * max(small.width, small.height)
        )

    def full(self, camera: Camera) -> Camera:
        """The same camera at the picture's size: square pixels, which rounding of a level's size may have bent."""
        width, height = self.size
        K = camera.resized(width, height).K.copy()
        K[0, 0] = K[1, 1] = float(np.sqrt(K[0, 0] * K[1, 1]))
        return Camera(camera.viewmat, K, width, height)

    def worth(self, refined: Refined, mirrored: bool, drawn: RasterSettings = OWN) -> float:
        """How much likelier the render makes the picture, times how well its edges are the picture's."""
        camera = refined.camera
        picture = resized(self.greys[mirrored], camera.width, camera.height)
        image, alpha, _ = render_depth(self.model, camera, settings=drawn)
        behind = fill_background(picture, alpha)
        composed = luma(image) + (0.0 if behind is None else (1.0 - alpha) * behind)
        shown, seen = (_edges(smooth(np.asarray(each, dtype=np.float32), 1.0)) for each in (composed, picture))
        both = float(np.sqrt(np.square(shown).sum() * np.square(seen).sum()))
        return refined.gain * max(float((shown * seen).sum()) / max(both, 1e-9), 0.0)


def _edges(grey: Float32) -> Float32:
    """(2, H, W) gradient of brightness, strong ones counted alike."""
    gy, gx = np.gradient(grey)
    gradient = np.stack([np.asarray(gy), np.asarray(gx)])
    return np.asarray(gradient / np.sqrt(np.square(gradient).sum(axis=0) + _EDGE**2), dtype=np.float32)
