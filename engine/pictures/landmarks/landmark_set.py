"""Landmarks of a model: keypoints of its renders with their places in the world (DESIGN 4.8).

They let the camera of a screenshot be found later, and are kept with the record.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float32, Int32


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Places of a model that a keypoint detector recognises; InputError if the arrays do not fit together.

    `points` (L, 3) in the world, `descriptors` (L, 128) as in `engine.pictures.landmarks.keypoints`, `views` (L,) in
    which each was seen.
    """

    points: Float32
    descriptors: npt.NDArray[np.uint8]
    views: Int32

    def __post_init__(self) -> None:
        count = len(self.points)
        shapes = (self.points.shape, self.descriptors.shape, self.views.shape)
        if shapes != ((count, 3), (count, 128), (count,)):
            raise InputError(f"landmarks have shapes {shapes}, expected (L, 3), (L, 128), (L,)")
        if self.descriptors.dtype != np.uint8:
            raise InputError(f"descriptors are {self.descriptors.dtype}, expected uint8")
        if not np.isfinite(self.points).all():
            raise InputError("landmarks hold points that are not finite")

    def __len__(self) -> int:
        return len(self.points)
