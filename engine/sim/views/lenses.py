"""Attacks that move pixels: lenses and a rolling shutter. Image attacks as in `engine.sim.image_attacks`.

A render is a pinhole's picture; these make of it what another camera would have taken. Where that camera looks past
the picture's edge there is black.
"""

from typing import Protocol

import numpy as np

from engine.errors import InputError
from engine.model import Float32, Float64
from engine.numerics.lens import BrownLens, FisheyeLens
from engine.sim.attack import check_fraction
from engine.sim.views.checks import check_image, finished

__all__ = ["FOCAL", "lens_brown", "lens_fisheye", "lens_radial", "rolling_shutter"]

FOCAL = 1.105
"""Focal length in widths of the picture where none is told: that of the generated rigs (49 degrees)."""

CALIBRATED = BrownLens(k1=-0.2834, k2=0.0740, p1=0.00194, p2=0.00018)
"""A wide machine-vision lens: EuRoC MAV's cam0 (Burri et al. 2016), its tangential part ten times as large."""


class _Lens(Protocol):
    def undistort(self, points: Float64) -> Float64: ...


def lens_radial(image: Float32, strength: float, rng: np.random.Generator, *, focal: float = FOCAL) -> Float32:
    """Plain radial distortion with k1 = `strength`: a barrel below zero, a pincushion above.

    Parameters
    ----------
    image : (H, W, 3) float32
    strength : float
        OpenCV's k1.
    rng : numpy.random.Generator
        Not used.
    focal : float
        Focal length of the picture, widths of it.

    Returns
    -------
    (H, W, 3) float32

    Raises
    ------
    InputError
        If a number is not finite or the image is not one.
    """
    return _through(image, BrownLens(k1=float(strength)), focal)


def lens_brown(image: Float32, strength: float, rng: np.random.Generator, *, focal: float = FOCAL) -> Float32:
    """Radial and tangential distortion of a calibrated lens (`CALIBRATED`), each coefficient times `strength`."""
    c, s = CALIBRATED, float(strength)
    return _through(image, BrownLens(s * c.k1, s * c.k2, s * c.k3, s * c.p1, s * c.p2), focal)


def lens_fisheye(image: Float32, strength: float, rng: np.random.Generator, *, focal: float = FOCAL) -> Float32:
    """A fisheye: `strength` 0 is the pinhole, 1/2 stereographic, 1 equidistant."""
    return _through(image, FisheyeLens(float(strength)), focal)


def rolling_shutter(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """A camera that pans while its rows are read: the last row is shifted by `strength` widths against the first."""
    from engine.numerics.resampling import remap

    check_image(image)
    check_fraction(abs(strength), "shift of the last row")
    height, width = image.shape[:2]
    positions = _pixels(height, width)
    positions[..., 0] += strength * width * (positions[..., 1] / height - 0.5)
    return finished(remap(image, positions)[0])


def _through(image: Float32, lens: _Lens, focal: float) -> Float32:
    from engine.numerics.resampling import remap

    check_image(image)
    if not (np.isfinite(focal) and focal > 0):
        raise InputError(f"focal length must be positive, got {focal}")
    height, width = image.shape[:2]
    center, unit = np.array([width / 2, height / 2]), focal * width
    positions = unit * lens.undistort((_pixels(height, width) - center) / unit) + center
    return finished(remap(image, positions)[0])


def _pixels(height: int, width: int) -> Float64:
    """(H, W, 2) coordinates x, y of the pixels' centres."""
    y, x = np.mgrid[:height, :width] + 0.5
    return np.stack([x, y], axis=-1)
