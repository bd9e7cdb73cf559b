"""Fisheye cameras: what they took is brought to the pinhole at their place, since only pinholes are drawn."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import CameraError
from engine.model import Camera, Float32

_ANGLES = 64  # from the axis to a corner, at which the lens is looked at


@dataclass(frozen=True, eq=False)
class FisheyeCamera(Camera):
    """An equidistant lens, OpenCV's `cv2.fisheye`: at the angle t from the axis, f t (1 + k1 t^2 + ... + k4 t^8).

    As a `Camera` it is the pinhole of the same focal length, which shows the middle of its picture.
    """

    bends: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # k1 to k4

    def __post_init__(self) -> None:
        super().__post_init__()
        corner = np.hypot(self.width / self.K[0, 0], self.height / self.K[1, 1]) / 2
        t = np.linspace(0.0, np.arctan(corner), _ANGLES)
        out = t * (1.0 + sum(k * t ** (2 * n) for n, k in enumerate(self.bends, 1)))
        if not (np.diff(out) > 0).all():
            raise CameraError(f"the fisheye {self.bends} bends back on itself within the picture")

    def undistort(self, picture: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], Camera]:
        """A picture (H, W, C) of this camera, of any size, as the pinhole took it; and the pinhole, of that size."""
        import cv2  # a heavy import that few pictures need

        height, width = picture.shape[:2]
        pinhole = self.resized(width, height)
        K = pinhole.K.copy()
        K[:2, 2] -= 0.5  # OpenCV's pixels have their centers at whole numbers
        maps = cv2.fisheye.initUndistortRectifyMap(K, np.array(self.bends), np.eye(3), K, (width, height), cv2.CV_32FC1)
        return np.ascontiguousarray(cv2.remap(picture, *maps, cv2.INTER_LINEAR)), pinhole


def without_fisheyes(pictures: Sequence[Float32], cameras: Sequence[Camera]) -> tuple[list[Float32], list[Camera]]:
    """Pictures and their cameras, those of fisheyes undistorted."""
    pairs = [
        camera.undistort(picture) if isinstance(camera, FisheyeCamera) else (picture, camera)
        for picture, camera in zip(pictures, cameras, strict=True)
    ]
    return [picture for picture, _ in pairs], [camera for _, camera in pairs]
