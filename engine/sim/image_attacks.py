"""Attacks on images: what happens to a screenshot on its way.

All are pure functions `(image, strength, rng) -> image` on float32 (H, W, 3) in 0..1; the result is float32
in 0..1 again and may have another size. InputError for anything else, or a strength out of range.
"""

import io
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float32
from engine.sim.attack import check_fraction, check_positive

__all__ = [
    "blur",
    "blur_small_kernel",
    "brightness",
    "crop_center",
    "crop_image",
    "jpeg",
    "noise_image",
    "rotate_image",
    "rotate_image_random",
    "scale_image",
    "scale_image_area",
]


def jpeg(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """JPEG at quality `strength` and back, with 4:2:0 chroma as encoders do by default."""
    from PIL import Image

    _check(image)
    if not (1 <= strength <= 100 and float(strength).is_integer()):
        raise InputError(f"JPEG quality must be a whole number from 1 to 100, got {strength}")
    levels = np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, format="JPEG", quality=int(strength), subsampling="4:2:0")
    with Image.open(io.BytesIO(buffer.getvalue())) as decoded:
        return (np.asarray(decoded, dtype=np.float32) / np.float32(255.0)).astype(np.float32)


def noise_image(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """White Gaussian noise of standard deviation `strength` on every channel, clipped."""
    _check(image)
    std = check_positive(strength, "noise std", zero=True)
    return _clipped(image + std * rng.standard_normal(image.shape, dtype=np.float32))


def blur(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Gaussian blur of `strength` pixels, the kernel as wide as that needs."""
    sigma = check_positive(strength, "blur sigma", zero=True)
    return _blurred(image, sigma, 2 * int(np.ceil(4.0 * sigma)) + 1)


def blur_small_kernel(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Gaussian blur of `strength` pixels cut off to 3x3, as the public code of the field runs it."""
    return _blurred(image, check_positive(strength, "blur sigma", zero=True), 3)


def rotate_image(image: Float32, strength: float, rng: np.random.Generator, *, expand: bool = False) -> Float32:
    """Rotation about the centre by `strength` degrees counter-clockwise, black where nothing was.

    Parameters
    ----------
    image : (H, W, 3) float32
    strength : float
        Degrees.
    rng : numpy.random.Generator
        Not used.
    expand : bool
        Let the canvas grow to hold the whole image; otherwise its corners are lost.

    Returns
    -------
    (H', W', 3) float32
        Bilinear; H' = H and W' = W unless `expand`.

    Raises
    ------
    InputError
        If the angle is not finite or the image is not one.
    """
    from skimage.transform import rotate

    _check(image)
    if not np.isfinite(strength):
        raise InputError(f"angle must be finite, got {strength}")
    return _clipped(rotate(image, strength, resize=expand, order=1, mode="constant", cval=0.0))


def rotate_image_random(image: Float32, strength: float, rng: np.random.Generator, *, expand: bool = False) -> Float32:
    """Rotation by an angle uniform in +-`strength` degrees, as public code runs "rotation 30"."""
    limit = check_positive(strength, "largest angle", zero=True)
    return rotate_image(image, float(rng.uniform(-limit, limit)), rng, expand=expand)


def scale_image(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Both sides times `strength`, averaging areas when smaller, bicubic when larger; not scaled back."""
    import cv2

    _check(image)
    factor = check_positive(strength, "scale factor")
    width, height = (max(1, round(side * factor)) for side in (image.shape[1], image.shape[0]))
    method = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    return _clipped(cv2.resize(np.ascontiguousarray(image), (width, height), interpolation=method))


def scale_image_area(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Number of pixels times `strength` (both sides times its root), as 3D-GSW runs "scaling 75 %"."""
    return scale_image(image, float(np.sqrt(check_positive(strength, "area factor"))), rng)


def crop_image(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Remove `strength` of the area: what stays has the image's proportions and lies at a random place."""
    _check(image)
    side = np.sqrt(1.0 - check_fraction(strength, "removed area"))
    height, width = (max(1, round(s * side)) for s in image.shape[:2])
    top = int(rng.integers(image.shape[0] - height + 1))
    left = int(rng.integers(image.shape[1] - width + 1))
    return _clipped(image[top : top + height, left : left + width])


def crop_center(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Keep the centre with both sides times `strength`, as GuardSplat runs "crop 40 %" (16 % of the area)."""
    _check(image)
    side = check_fraction(strength, "kept side", zero=False, one=True)
    height, width = (max(1, round(s * side)) for s in image.shape[:2])
    top, left = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
    return _clipped(image[top : top + height, left : left + width])


def brightness(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Every value times `strength`, clipped."""
    _check(image)
    return _clipped(image * np.float32(check_positive(strength, "brightness factor", zero=True)))


def _blurred(image: Float32, sigma: float, taps: int) -> Float32:
    import cv2

    _check(image)
    if sigma == 0:
        return _clipped(image)
    kernel = cv2.getGaussianKernel(taps, sigma)
    return _clipped(cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT))


def _check(image: npt.NDArray[Any]) -> None:
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise InputError(f"expected an image (H, W, 3), got shape {image.shape}")
    if image.dtype != np.float32:
        raise InputError(f"expected a float32 image from 0 to 1, got {image.dtype}")


def _clipped(image: npt.NDArray[Any]) -> Float32:
    """A fresh contiguous float32 image in 0..1, never a view of the input."""
    return np.ascontiguousarray(np.clip(image, 0.0, 1.0), dtype=np.float32)
