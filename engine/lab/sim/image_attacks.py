"""Attacks on images: what happens to a screenshot on its way.

All are pure functions `(image, strength, rng) -> image` on float32 (H, W, 3) in 0..1; the result may have another
size. What is no such image, and what a strength may be, `Attack.apply` has checked.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.attack import Attacks
from engine.lab.sim.views.encoders import still
from engine.model import Float32

__all__ = ["ATTACKS"]

ATTACKS: Attacks[Float32] = Attacks("image")

Picture = npt.NDArray[Any]


@ATTACKS.add("JPEG with 4:2:0 chroma", "quality", 10, (95, 90, 75, 50, 40, 30, 20, 10, 5, 1), "1..100")
def jpeg(image: Float32, strength: int, rng: np.random.Generator) -> Picture:
    return still(image, "JPEG", strength, subsampling="4:2:0")


# "0.1" is squared before it scales the noise in GuardSplat and 3D-GSW.
@ATTACKS.as_code("noise_image", "std, range 1", 0.01, (0.0025, 0.005, 0.01, 0.02), "[0, inf)")
@ATTACKS.add(
    "white Gaussian noise, clipped", "std, range 1", 0.1, (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.316, 0.5), "[0, inf)"
)
def noise_image(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    return np.asarray(image + strength * rng.standard_normal(image.shape, dtype=np.float32))


@ATTACKS.add("Gaussian blur", "sigma, pixels", 1.0, (0.1, 0.3, 0.5, 0.8, 1, 1.5, 2, 3, 5, 8), "[0, inf)")
def blur(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    """The kernel is as wide as that needs."""
    return _blurred(image, strength, 2 * int(np.ceil(4.0 * strength)) + 1)


@ATTACKS.as_code("blur", "sigma, 3x3 pixels", 0.8, (0.1, 0.5, 0.8, 1.5), "[0, inf)")
def blur_small_kernel(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    """The kernel is cut off to 3x3, as the public code of the field runs it."""
    return _blurred(image, strength, 3)


@ATTACKS.add(
    "rotate the picture on its canvas, black corners", "degrees", 30.0, (0.1, 0.5, 1, 3, 10, 20, 30, 45, 90, 180)
)
def rotate_image(image: Float32, strength: float, rng: np.random.Generator, *, expand: bool = False) -> Picture:
    """Rotation about the centre by `strength` degrees counter-clockwise, bilinear, black where nothing was.

    `expand` lets the canvas grow to hold the whole image; otherwise its corners are lost.
    """
    from skimage.transform import rotate

    return np.asarray(rotate(image, strength, resize=expand, order=1, mode="constant", cval=0.0))


@ATTACKS.add(
    "turn the picture over, as front cameras and re-posters do",
    "what changes places: left-right, up-down or, over the diagonal, both",
    "left-right",
    ("left-right", "up-down", "diagonal"),
)
def mirror_image(image: Float32, strength: str, rng: np.random.Generator) -> Picture:
    over = {"left-right": image[:, ::-1], "up-down": image[::-1], "diagonal": image.swapaxes(0, 1)}
    if strength not in over:
        raise InputError(f"mirror_image: {strength!r} is none of {', '.join(over)}")
    return over[strength]


@ATTACKS.as_code("rotate_image", "largest angle, degrees", 30.0, (1, 10, 30, 90), "[0, inf)")
def rotate_image_random(image: Float32, strength: float, rng: np.random.Generator, *, expand: bool = False) -> Picture:
    """Rotation by an angle uniform in +-`strength` degrees, as public code runs "rotation 30"."""
    return rotate_image(image, float(rng.uniform(-strength, strength)), rng, expand=expand)


@ATTACKS.add(
    "resize, not scaled back", "factor on each side", 0.75, (1.5, 0.95, 0.9, 0.75, 0.5, 0.25, 0.125), "(0, inf)"
)
def scale_image(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    """Averages areas when smaller, bicubic when larger."""
    import cv2

    width, height = (max(1, round(side * strength)) for side in (image.shape[1], image.shape[0]))
    method = cv2.INTER_AREA if strength < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(np.ascontiguousarray(image), (width, height), interpolation=method))


@ATTACKS.as_code("scale_image", "factor on the area", 0.75, (0.9, 0.75, 0.5, 0.25), "(0, inf)")
def scale_image_area(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    """Number of pixels times `strength` (both sides times its root), as 3D-GSW runs "scaling 75 %"."""
    return scale_image(image, float(np.sqrt(strength)), rng)


@ATTACKS.add("cut a piece out", "removed area", 0.4, (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 0.96), "[0, 1)")
def crop_image(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    """What stays has the image's proportions and lies at a random place."""
    height, width = (max(1, round(s * np.sqrt(1.0 - strength))) for s in image.shape[:2])
    top = int(rng.integers(image.shape[0] - height + 1))
    left = int(rng.integers(image.shape[1] - width + 1))
    return image[top : top + height, left : left + width]


@ATTACKS.as_code("crop_image", "kept side, centred", 0.4, (0.9, 0.707, 0.4, 0.316, 0.2), "(0, 1]")
def crop_center(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    """Keep the centre with both sides times `strength`, as GuardSplat runs "crop 40 %" (16 % of the area)."""
    height, width = (max(1, round(s * strength)) for s in image.shape[:2])
    top, left = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
    return image[top : top + height, left : left + width]


@ATTACKS.add("multiply and clip", "factor", 1.5, (0.95, 1.05, 0.9, 1.1, 0.75, 1.25, 0.5, 1.5, 2.0, 4.0), "[0, inf)")
def brightness(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    return image * np.float32(strength)


def _blurred(image: Float32, sigma: float, taps: int) -> Picture:
    import cv2

    if sigma == 0:
        return image
    kernel = cv2.getGaussianKernel(taps, sigma)
    return np.asarray(cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT))
