"""Pixels that are not square: of a picture made narrower or wider, or of a screen photographed from aside (DESIGN 4.8).

A camera with square pixels, seen through any plane, is again a camera, whose pixels are two numbers away from square.
"""

from dataclasses import dataclass

import numpy as np

from engine.model import Camera, Float32, Float64


@dataclass(frozen=True)
class PixelShape:
    """What became of square pixels: x' = ratio x + slant y, y' = y."""

    ratio: float = 1.0
    slant: float = 0.0

    @property
    def matrix(self) -> Float64:
        """(2, 2) from square pixels to the picture's."""
        return np.array([[self.ratio, self.slant], [0.0, 1.0]])

    def turned_over(self) -> "PixelShape":
        """The same of the picture turned over left to right."""
        return PixelShape(self.ratio, -self.slant)

    def after(self, rest: "PixelShape") -> "PixelShape":
        """The shape of a picture that has this rest when it was taken back by what this one says."""
        matrix = self.matrix @ rest.matrix
        return PixelShape(float(matrix[0, 0]), float(matrix[0, 1]))

    def squared(self, points: Float64) -> Float64:
        """Points (P, 2) of the picture in square pixels."""
        return np.ascontiguousarray(points @ np.linalg.inv(self.matrix).T)

    def square_size(self, width: int, height: int) -> tuple[int, int]:
        """Width and height of such a picture in square pixels, none of them larger than before."""
        _, size = self._extent(width, height)
        return size

    def squared_camera(self, camera: Camera, width: int, height: int) -> Camera:
        """The camera of such a picture taken back, of one whose pixels become the picture's."""
        shift, size = self._extent(width, height)
        K = camera.K.copy()
        K[:2] *= max(self.ratio, 1.0)
        K[:2, 2] += shift
        return Camera(camera.viewmat, K, *size)

    def undo(self, image: Float32) -> Float32:
        """The picture (h, w, 3) in square pixels, none of them larger than before; 0 where it shows nothing."""
        import cv2

        matrix = self._enlarging
        shift, size = self._extent(image.shape[1], image.shape[0])
        shift = shift + matrix @ np.array([0.5, 0.5]) - 0.5  # OpenCV counts from the pixels' centres
        back = cv2.warpAffine(image, np.column_stack([matrix, shift]), size, flags=cv2.INTER_CUBIC)
        return np.asarray(np.clip(back, 0.0, 1.0), dtype=np.float32)

    @property
    def _enlarging(self) -> Float64:
        return np.asarray(max(self.ratio, 1.0) * np.linalg.inv(self.matrix))

    def _extent(self, width: int, height: int) -> tuple[Float64, tuple[int, int]]:
        corners = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]]) @ self._enlarging.T
        shift = -corners.min(axis=0)
        across, down = np.ceil(corners.max(axis=0) + shift - 1e-6)
        return shift, (int(across), int(down))


SQUARE = PixelShape()
