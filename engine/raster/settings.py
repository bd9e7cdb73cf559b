"""What defines the image, in addition to the model and the camera."""

import math
from dataclasses import dataclass

from engine.errors import InputError
from engine.model import Float32

TILE = 16
"""Side of a tile, pixels. A Gaussian's list entry is one (tile, Gaussian) pair."""

BLOCK = 4
"""Side of a block, pixels: 4 x 4 pixels are the 16 lanes of one vector, and a tile is 4 x 4 blocks."""

ALPHA_SKIP = 1.0 / 255.0
"""An alpha below one grey level of an 8-bit image is not blended (gsplat's ALPHA_THRESHOLD)."""

KERNELS = ("auto", "gaussian", "disc")

MAX_SIGMA_PX = 1e6
"""A Gaussian wider than this on the image plane is not drawn: float32 can no longer place it."""

FRUSTUM_MARGIN = 0.3
"""The Jacobian of the projection is taken at most this part of the half field of view outside the image
(gsplat)."""


@dataclass(frozen=True, eq=False)
class EarlyStop:
    """The paper's further rule (Eq 8): a pixel ends once sum_j alpha_j W_j >= tau.

    Of a picture alone: gradients and sums of weights are those of the whole image. W (N,) is W^freq of every Gaussian,
    or its rank in (0, 1]; alphas are not multiplied with the transmittance, so a tau above 1 stops pixels, too. The
    Gaussian that reaches tau is still blended.
    """

    weights: Float32
    tau: float = 0.95  # the paper's text; its appendix finds 1.2 best

    def __post_init__(self) -> None:
        if not 0.0 < self.tau < math.inf:
            raise InputError(f"tau of the early stop is {self.tau}, expected a number above 0")


@dataclass(frozen=True)
class RasterSettings:
    """Definition of the image. The defaults are gsplat's, so that CPU and GPU agree."""

    eps2d: float = 0.3  # added to both variances of the projected Gaussian, square pixels
    near: float = 0.01  # Gaussians whose centre is nearer than this are not drawn, scene units
    alpha_clamp: float = 0.999  # largest alpha, in (0, 1); INRIA's code has 0.99
    alpha_skip: float = ALPHA_SKIP  # smallest alpha that is blended, in (0, alpha_clamp)
    transmittance_stop: float = 1e-4
    """A Gaussian that would bring a pixel's transmittance to this or less is not blended and ends the pixel."""
    antialiased: bool | None = None
    """Opacity falls as `eps2d` widens the projected Gaussian, so that none gets heavier (Mip-Splatting, Yu et al. 2024,
    Eq 10, in the image plane alone; viewers call it antialiasing). Gaussians only, not discs; no gradients of
    parameters. None: where the model was trained so (`GaussianModel.antialiased`)."""
    by_distance: bool = False
    """Blended in the order of their distance from the camera, as viewers do that sort once for all directions it may be
    turned to (SuperSplat's, Spark's), in place of their depth: large Gaussians near a wide lens change places."""
    kernel: str = "auto"
    """What is drawn: "gaussian", or "disc", those of 2DGS, of the first two scales, which rays meet exactly in
    perspective and which have a low pass of their own in place of `eps2d` (`engine.raster.disc_projection`); "auto":
    discs where the model is flat (`GaussianModel.is_flat`), else Gaussians."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.eps2d <= 100.0:
            raise InputError(f"eps2d is {self.eps2d}, expected 0 to 100 square pixels")
        if not 1e-6 <= self.near < math.inf:
            raise InputError(f"near is {self.near}, expected at least 1e-6")
        if not 0.0 < self.alpha_skip < self.alpha_clamp < 1.0:
            raise InputError(f"need 0 < alpha_skip < alpha_clamp < 1, got {self.alpha_skip} and {self.alpha_clamp}")
        if not 0.0 < self.transmittance_stop < 1.0:
            raise InputError(f"transmittance_stop is {self.transmittance_stop}, expected 0 to 1")
        if self.kernel not in KERNELS:
            raise InputError(f"kernel must be one of {', '.join(KERNELS)}, got {self.kernel!r}")

    @property
    def log2_alpha_skip(self) -> float:
        """Exponent below which a Gaussian is skipped: alpha = 2^q, so the cut is a compare before the
        exponential."""
        return math.log2(self.alpha_skip)
