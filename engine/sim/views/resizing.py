"""Attacks by resizing down (or up) and back to the old size, one per kernel. Image attacks."""

from functools import partial

import numpy as np

from engine.errors import InputError
from engine.model import Float32
from engine.sim.attack import check_positive
from engine.sim.views.checks import check_image, finished

__all__ = ["KERNELS", "resize_area", "resize_bilinear", "resize_lanczos", "resize_nearest", "there_and_back"]

KERNELS = {"nearest": "INTER_NEAREST_EXACT", "bilinear": "INTER_LINEAR", "area": "INTER_AREA", "lanczos": "LANCZOS"}
"""OpenCV's kernels, which do not widen when shrinking; Lanczos is Pillow's, which does."""

MOST_PIXELS = 1 << 28


def there_and_back(image: Float32, strength: float, rng: np.random.Generator, *, kernel: str = "bilinear") -> Float32:
    """Both sides times `strength` and back again.

    Parameters
    ----------
    image : (H, W, 3) float32
    strength : float
        Factor on each side on the way there, above 0.
    rng : numpy.random.Generator
        Not used.
    kernel : {"nearest", "bilinear", "area", "lanczos"}
        Of both ways.

    Returns
    -------
    (H, W, 3) float32

    Raises
    ------
    InputError
        If the factor is not positive, the kernel is unknown or the image is not one.
    """
    check_image(image)
    factor = check_positive(strength, "resize factor")
    if kernel not in KERNELS:
        raise InputError(f"no kernel is called {kernel!r}; there are {', '.join(KERNELS)}")
    height, width = image.shape[:2]
    rows, columns = max(1, round(height * factor)), max(1, round(width * factor))
    if rows * columns > MOST_PIXELS:
        raise InputError(f"resize factor {factor} makes {columns}x{rows} pixels; {MOST_PIXELS} at most")
    return finished(_resized(_resized(image, rows, columns, kernel), height, width, kernel))


resize_nearest = partial(there_and_back, kernel="nearest")
resize_bilinear = partial(there_and_back, kernel="bilinear")
resize_area = partial(there_and_back, kernel="area")
resize_lanczos = partial(there_and_back, kernel="lanczos")


def _resized(image: Float32, height: int, width: int, kernel: str) -> Float32:
    if kernel == "lanczos":
        from PIL import Image

        planes = [
            np.asarray(Image.fromarray(image[..., c]).resize((width, height), Image.Resampling.LANCZOS))
            for c in range(3)
        ]
        return np.stack(planes, axis=-1)
    import cv2

    method = getattr(cv2, KERNELS[kernel])
    return np.asarray(cv2.resize(np.ascontiguousarray(image), (width, height), interpolation=method))
