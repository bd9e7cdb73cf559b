"""What every view distortion checks on the way in and guarantees on the way out."""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float32

__all__ = ["bytes_of", "check_image", "finished"]


def check_image(image: npt.NDArray[Any]) -> None:
    """InputError unless the image is (H, W, 3) float32 and not empty."""
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise InputError(f"expected an image (H, W, 3), got shape {image.shape}")
    if image.dtype != np.float32:
        raise InputError(f"expected a float32 image from 0 to 1, got {image.dtype}")


def finished(image: npt.NDArray[Any]) -> Float32:
    """A fresh contiguous float32 image in 0..1."""
    return np.ascontiguousarray(np.clip(image, 0.0, 1.0), dtype=np.float32)


def bytes_of(image: Float32) -> npt.NDArray[np.uint8]:
    """The image in 8 bits, as encoders take it."""
    check_image(image)
    return np.asarray(np.round(np.clip(image, 0.0, 1.0) * 255.0), dtype=np.uint8)
