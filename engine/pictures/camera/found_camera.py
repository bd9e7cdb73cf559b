"""What the search for the camera of a picture found."""

from dataclasses import dataclass

import numpy as np

from engine.model import Camera, Float32
from engine.pictures.camera.pixel_shape import PixelShape
from engine.raster import RasterSettings

DEFAULT_SETTINGS = RasterSettings()
"""How most viewers draw."""


@dataclass(frozen=True, eq=False)
class FoundCamera:
    """The camera of a picture."""

    camera: Camera  # of what `face` makes of the picture; square pixels
    inliers: int  # matches that agree with the pose found from keypoints; 0 where these did not help
    rms: float  # robust standard deviation of the brightness residual, 0..1
    correlation: float  # of picture and render, -1..1
    step: float  # root mean square flow of the last step of the refinement, pixels
    gain: float = 0.0  # how much likelier its render makes the picture than a flat colour does, natural logarithm
    uncovered_correlation: float = 0.0  # of picture and render where nothing lies over the model
    mirrored: bool = False  # it is the camera of the picture turned over left to right
    settings: RasterSettings = DEFAULT_SETTINGS  # with which the render of the reference is most like it
    shape: PixelShape | None = None  # of the picture's pixels, where these are not square
    frame: tuple[slice, slice] | None = None  # rows and columns in which that picture shows it, where not in all

    def face(self, image: Float32) -> Float32:
        """The picture (h, w, 3) as this camera sees it: with square pixels, cut to its frame, turned over left to right
        if mirrored."""
        if self.shape is not None:
            image = self.shape.undo(image)
        if self.frame is not None:
            image = np.ascontiguousarray(image[self.frame])
        return np.ascontiguousarray(image[:, ::-1]) if self.mirrored else image

    def of_whole(self, image: Float32) -> Camera:
        """The camera of the whole picture (h, w, 3), in square pixels, turned over if mirrored."""
        height, width = image.shape[:2]
        if self.shape is not None:
            width, height = self.shape.square_size(width, height)
        if self.frame is None:
            return self.camera
        rows, columns = self.frame
        K = self.camera.K.copy()
        K[:2, 2] += width - columns.stop if self.mirrored else columns.start, rows.start
        return Camera(self.camera.viewmat, K, width, height)
