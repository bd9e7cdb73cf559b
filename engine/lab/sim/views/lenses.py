"""Attacks that move pixels: lenses and a rolling shutter. Image attacks as in `engine.lab.sim.image_attacks`.

A render is a pinhole's picture; these make of it what another camera would have taken. Where that camera looks past
the picture's edge there is black.
"""

import numpy as np

from engine.lab.sim.attack import Attacks
from engine.model import Float32, Float64
from engine.numerics.lens import BrownLens, FisheyeLens

__all__ = ["ATTACKS"]

ATTACKS: Attacks[Float32] = Attacks("image")

FOCAL = 1.105
"""Focal length in widths of the picture: that of the generated rigs (49 degrees)."""

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
    """(H, W, 2) coordinates x, y of the pixels' centres."""
    y, x = np.mgrid[:height, :width] + 0.5
    return np.stack([x, y], axis=-1)
