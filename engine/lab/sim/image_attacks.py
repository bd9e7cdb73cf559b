"""Attacks on images: what happens to a screenshot on its way, by lenses, tone curves, overlays and denoisers.

All are pure functions `(image, strength, rng) -> image` on float32 (H, W, 3) in 0..1, values as displayed (sRGB); the
result may have another size. `Attack.apply` has checked image and strength. A render is a pinhole's picture; the lenses
make of it what another camera would have taken, black where that camera looks past the picture's edge. Regeneration by
a variational auto-encoder or a diffusion model needs trained networks and is not included.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.attack import Attacks
from engine.lab.sim.image_encoders import bytes_of, still, values_of
from engine.lab.sim.lens import BrownLens, FisheyeLens
from engine.model import Float32, Float64
from engine.numerics.srgb import from_linear, to_linear

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


@ATTACKS.add("motion blur along a line", "length, pixels", 15.0, (1, 2, 4, 8, 15, 25), "[0, 200]")
def motion_blur(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    """A camera or hand that moves while the picture is taken; the direction is random."""
    import cv2

    half = int(np.ceil(strength / 2.0))
    angle = rng.uniform(0.0, np.pi)
    kernel = np.zeros((2 * half + 1, 2 * half + 1), dtype=np.float32)
    along = np.linspace(-0.5, 0.5, 16 * (half + 1) + 1) * strength
    for x, y in zip(half + along * np.cos(angle), half + along * np.sin(angle), strict=True):
        left, top = int(np.floor(x)), int(np.floor(y))
        for column, row in ((left, top), (left + 1, top), (left, top + 1), (left + 1, top + 1)):
            if 0 <= column < len(kernel) and 0 <= row < len(kernel):
                kernel[row, column] += (1.0 - abs(x - column)) * (1.0 - abs(y - row))
    kernel /= kernel.sum()
    return np.asarray(cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REFLECT))


@ATTACKS.add(
    "rotate the picture on its canvas, black corners", "degrees", 30.0, (0.1, 0.5, 1, 3, 10, 20, 30, 45, 90, 180)
)
def rotate_image(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    """Rotation about the center by `strength` degrees counter-clockwise, bilinear, black where nothing was."""
    from skimage.transform import rotate

    return np.asarray(rotate(image, strength, order=1, mode="constant", cval=0.0))


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
def rotate_image_random(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    """Rotation by an angle uniform in +-`strength` degrees, as public code runs "rotation 30"."""
    return rotate_image(image, float(rng.uniform(-strength, strength)), rng)


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


@ATTACKS.as_code("crop_image", "kept side, centered", 0.4, (0.9, 0.707, 0.4, 0.316, 0.2), "(0, 1]")
def crop_center(image: Float32, strength: float, rng: np.random.Generator) -> Picture:
    """Keep the center with both sides times `strength`, as GuardSplat runs "crop 40 %" (16 % of the area)."""
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


FOCAL = 1.105  # focal length in widths of the picture: that of the generated rigs (49 degrees)

CALIBRATED = BrownLens(k1=-0.2834, k2=0.0740, p1=0.00194, p2=0.00018)
"""A wide machine-vision lens: EuRoC MAV's cam0 (Burri et al. 2016), its tangential part ten times as large."""


@ATTACKS.add(
    "a lens with radial distortion: barrel or pincushion",
    "k1, below 0 a barrel",
    -0.1,
    (-0.01, 0.01, -0.03, 0.03, -0.1, 0.1, -0.2, 0.2, -0.3, 0.3),
)
def lens_radial(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """OpenCV's k1."""
    return _through(image, BrownLens(k1=strength))


@ATTACKS.add(
    "a wide lens with radial and tangential distortion",
    "multiples of a calibrated lens",
    0.5,
    (0.05, 0.1, 0.25, 0.5, 0.75, 1.0),
)
def lens_brown(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Each coefficient of `CALIBRATED` times `strength`."""
    c, s = CALIBRATED, strength
    return _through(image, BrownLens(s * c.k1, s * c.k2, s * c.k3, s * c.p1, s * c.p2))


@ATTACKS.add(
    "a fisheye lens", "0 pinhole, 1/2 stereographic, 1 equidistant", 0.5, (0.05, 0.1, 0.25, 0.5, 1.0), "[0, 1]"
)
def lens_fisheye(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    return _through(image, FisheyeLens(strength))


@ATTACKS.add(
    "a camera that pans while its rows are read",
    "shift of the last row, widths",
    0.03,
    (0.002, 0.01, 0.03, 0.1, 0.2),
    "(-1, 1)",
)
def rolling_shutter(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """The shift is against the first row."""
    from engine.numerics.resampling import remap

    height, width = image.shape[:2]
    positions = _pixels(height, width)
    positions[..., 0] += strength * width * (positions[..., 1] / height - 0.5)
    return remap(image, positions)[0]


def _through(image: Float32, lens: BrownLens | FisheyeLens) -> Float32:
    from engine.numerics.resampling import remap

    height, width = image.shape[:2]
    center, unit = np.array([width / 2, height / 2]), FOCAL * width
    positions = unit * lens.undistort((_pixels(height, width) - center) / unit) + center
    return remap(image, positions)[0]


def _pixels(height: int, width: int) -> Float64:
    """(H, W, 2) coordinates x, y of the pixels' centers."""
    y, x = np.mgrid[:height, :width] + 0.5
    return np.stack([x, y], axis=-1)


Values = npt.NDArray[Any]

FLICKER_BANDS = 3.3  # bands down a picture: lamps pulse 100 times a second, and rows are read within 1/30 s

LUMA = np.array([0.299, 0.587, 0.114])

# Linear light from Display P3 to sRGB primaries, both D65 (CSS Color 4, sample code).
_P3_TO_SRGB = np.array(
    [
        [1.2249401762805598, -0.22494017628055996, 0.0],
        [-0.042056954709688163, 1.0420569547096881, 0.0],
        [-0.019637554590334432, -0.078636045550631889, 1.0982736001409663],
    ]
)


@ATTACKS.add(
    "a gain that changes from the first row to the last",
    "change of the gain",
    0.3,
    (0.05, 0.1, 0.2, 0.3, 0.5, 0.8),
    "[0, 1]",
)
def rolling_exposure(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """Exposure that runs while rows are read: gain from 1 - `strength`/2 at the top to 1 + `strength`/2."""
    return image * (1.0 + strength * (_heights(image) - 0.5))


@ATTACKS.add("bands of mains flicker", "depth of the bands", 0.1, (0.02, 0.05, 0.1, 0.2, 0.4), "[0, 1]")
def flicker(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """Gain 1 +- `strength` in 3.3 waves down the picture, at a random phase."""
    phase = rng.uniform(0.0, 2.0 * np.pi)
    return image * (1.0 + strength * np.sin(2.0 * np.pi * FLICKER_BANDS * _heights(image) + phase))


@ATTACKS.add(
    "light lost towards the corners", "share lost in the corners", 0.3, (0.05, 0.1, 0.2, 0.3, 0.5, 0.7), "[0, 1)"
)
def vignette(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """By the cosine-fourth law."""
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width] + 0.5
    # (squared distance from the center, 1 in the corners); cos^4 = (1 + tan^2)^-2
    r2 = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
    slope = 1.0 / np.sqrt(1.0 - strength) - 1.0
    return np.asarray(image * (1.0 + slope * r2)[..., None] ** -2.0)


@ATTACKS.add(
    "every value to a power", "exponent", 2.2, (0.9, 1.1, 0.8, 1.25, 0.6, 1.6, 0.4545, 2.2, 0.33, 3.0), "(0, inf)"
)
def gamma(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """Below 1 brighter, above darker."""
    return np.asarray(np.clip(image, 0.0, 1.0) ** strength)


@ATTACKS.add("the film curve of ACES over linear light", "exposure", 1.0, (0.6, 0.8, 1.0, 1.5, 2.5, 4.0), "(0, inf)")
def filmic(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """Narkowicz's fit of 2015."""
    x = strength * to_linear(np.clip(image, 0.0, 1.0))
    return from_linear(np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0))


@ATTACKS.add(
    "distance from mid-grey multiplied, clipped",
    "factor",
    1.3,
    (0.95, 1.05, 0.8, 1.2, 1.3, 0.5, 1.6, 0.3, 2.5),
    "[0, inf)",
)
def contrast(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    return np.asarray(0.5 + strength * (image - 0.5))


@ATTACKS.add(
    "distance from the pixel's grey multiplied, clipped",
    "factor",
    1.5,
    (0.9, 1.1, 0.7, 1.5, 0.3, 2.0, 0.0, 3.0),
    "[0, inf)",
)
def saturation(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """0 is black and white."""
    grey = (image @ LUMA)[..., None]
    return np.asarray(grey + strength * (image - grey))


@ATTACKS.add("warmer or cooler light", "red over blue", 1.3, (0.95, 1.05, 0.8, 1.3, 0.6, 1.7, 0.4, 2.5), "(0, inf)")
def white_balance(image: Float32, strength: float, rng: np.random.Generator) -> Values:
    """Red times the root of `strength` and blue divided by it: above 1 warmer, below cooler."""
    tint = np.sqrt(strength)
    return np.asarray(image * np.array([tint, 1.0, 1.0 / tint]))


def _primaries(matrix: Float64) -> Callable[[Float64], Float64]:
    return lambda values: from_linear(np.clip(to_linear(values) @ matrix.T, 0.0, 1.0))


VIEWERS: dict[str, Callable[[Float64], Float64]] = {
    # Numbers for an sRGB screen, kept by a P3 screenshot without its profile: pale.
    "p3_as_srgb": _primaries(np.linalg.inv(_P3_TO_SRGB)),
    # sRGB numbers taken for P3 and brought to sRGB: gaudy, with clipped primaries.
    "srgb_as_p3": _primaries(_P3_TO_SRGB),
    # Decoded for blending and never encoded again: dark.
    "srgb_missing": to_linear,
    # Encoded by the shader and once more by the frame buffer: washed out.
    "srgb_twice": from_linear,
}
"""What web viewers do wrong, by name, mildest first."""


@ATTACKS.add("a screenshot from a viewer that manages color wrongly", "mistake", "srgb_twice", tuple(VIEWERS))
def viewer_color(image: Float32, strength: str, rng: np.random.Generator) -> Values:
    if strength not in VIEWERS:
        raise InputError(f"no viewer mistake is called {strength!r}; there are {', '.join(VIEWERS)}")
    return VIEWERS[strength](np.clip(image, 0.0, 1.0).astype(np.float64))


def _heights(image: Float32) -> Float64:
    """(H, 1, 1) middle of each row, 0 at the top edge and 1 at the bottom edge."""
    return np.asarray((np.arange(image.shape[0]) + 0.5) / image.shape[0])[:, None, None]


LETTERS = "PREVIEW"
SLANT = 30.0  # degrees by which the lettering rises
LINE = 0.08  # from one line of it to the next, longer sides of the picture; letters are a third as high
CHEQUER = 0.011
"""Side of a field, longer sides of the picture: between what pixels and what whole parts of a model are made of."""


@ATTACKS.add(
    "white lettering all over, as on previews that are for sale", "opacity", 0.3, (0.1, 0.2, 0.3, 0.45, 0.6), "[0, 1]"
)
def lettering(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Slanted lines of words, every other shifted by half a word."""
    letters = _letters(*image.shape[:2])[..., None]
    return image + np.float32(strength) * letters * (1.0 - image)


@ATTACKS.add(
    "fields of a chessboard, lighter and darker", "change of brightness", 0.02, (0.01, 0.02, 0.04, 0.06, 0.08), "[0, 1]"
)
def chequers(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """A coarse pattern that no coder takes off again."""
    height, width = image.shape[:2]
    side = max(1.0, CHEQUER * max(height, width))
    rows, columns = ((np.arange(count) // side).astype(np.int64) for count in (height, width))
    board = np.where((rows[:, None] + columns) % 2, np.float32(strength), np.float32(-strength))
    return image + board[..., None]


def _letters(height: int, width: int) -> Float32:
    """(H, W) how far a pixel is covered."""
    import cv2

    side = max(height, width)
    line = max(6.0, LINE * side)
    face, scale = cv2.FONT_HERSHEY_DUPLEX, line / 3.0 / 22.0  # its capitals are 22 pixels high
    word = cv2.getTextSize(LETTERS, face, scale, 1)[0][0] + line
    reach = int(np.ceil(np.hypot(height, width)))  # however it is turned, the corners are covered
    sheet = np.zeros((reach, reach), dtype=np.uint8)
    for number, y in enumerate(np.arange(line, reach + line, line)):
        for x in np.arange(-0.5 * word * (number % 2), reach, word):
            thick = max(1, round(scale * 2.0))
            cv2.putText(sheet, LETTERS, (round(float(x)), round(float(y))), face, scale, 255, thick, cv2.LINE_AA)
    turn = cv2.getRotationMatrix2D((reach / 2, reach / 2), SLANT, 1.0)
    turn[:, 2] += (width - reach) / 2, (height - reach) / 2
    turned = cv2.warpAffine(sheet, turn, (width, height), flags=cv2.INTER_LINEAR)
    return np.asarray(turned, dtype=np.float32) / np.float32(255.0)


BILATERAL_REACH = 3.0  # spatial standard deviation of the bilateral filter, pixels

PATCH, SEARCH = 7, 21
"""Sides of the patches compared and of the window searched by non-local means, pixels (Buades 2005)."""

WAVELET_LEVELS = 4


@ATTACKS.add("median filter", "side, pixels", 3, (3, 5, 7, 9, 15), "1..31")
def median(image: Float32, strength: int, rng: np.random.Generator) -> Float32:
    """Over a square with an odd side, each channel by itself."""
    import cv2

    if strength % 2 == 0:
        raise InputError(f"side of the median must be odd, from 1 to 31, got {strength}")
    return values_of(cv2.medianBlur(bytes_of(image), strength))


@ATTACKS.add("bilateral filter", "color std, range 1", 0.1, (0.02, 0.05, 0.1, 0.2, 0.4), "(0, inf)")
def bilateral(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Of 3 pixels (Tomasi and Manduchi 1998)."""
    import cv2

    size = 2 * int(np.ceil(2.0 * BILATERAL_REACH)) + 1
    return np.asarray(cv2.bilateralFilter(np.ascontiguousarray(image), size, strength, BILATERAL_REACH))


@ATTACKS.add("non-local means", "filter strength, grey levels", 5, (2, 3, 5, 10, 20), "(0, inf)")
def denoise_nonlocal(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """In Lab (Buades, Coll and Morel 2005)."""
    import cv2

    return values_of(cv2.fastNlMeansDenoisingColored(bytes_of(image), None, strength, strength, PATCH, SEARCH))


@ATTACKS.add(
    "shrink the details of a wavelet transform", "threshold, range 1", 0.03, (0.005, 0.01, 0.03, 0.1, 0.2), "[0, inf)"
)
def denoise_wavelet(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Soft-threshold the details of four Haar levels at `strength` (std, range 1), on 4 shifts averaged.

    Donoho's shrinkage, cycle-spun (Coifman and Donoho 1995) so that no blocks appear; all channels alike.
    """
    from engine.numerics.wavelet import dwt2, idwt2

    threshold = np.float32(strength)
    total = np.zeros_like(image)
    for shift in ((0, 0), (1, 2), (2, 1), (3, 3)):
        moved = np.roll(image, shift, axis=(0, 1))
        approx, details = dwt2(moved, WAVELET_LEVELS)
        shrunk = [tuple(np.sign(b) * np.maximum(np.abs(b) - threshold, 0) for b in bands) for bands in details]
        total += np.roll(idwt2(approx, shrunk), (-shift[0], -shift[1]), axis=(0, 1))
    return np.asarray(total / np.float32(4.0))
