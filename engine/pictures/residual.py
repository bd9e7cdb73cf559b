"""What a picture says that the unmarked reference does not, weighted by how far it can be believed.

1. Colour: affine change, clipping, tone curve and uneven light are fitted and taken off (`color_fit`).
2. Sharpness and position: the residual is regressed on gradients and Laplacians of the reference; what blur,
   resampling and a few hundredths of a pixel leave behind is explained by these.
3. Reliability: the residual's Haar bands, brightness and chroma apart, are divided by their own spread, so
   that bands drowned in noise or texture count little; outliers are clipped.

Everything depends on the picture and the unmarked reference alone: no key, no chip, no mark (DESIGN 4.9).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Bool, Float32
from engine.numerics.wavelet import dwt2, idwt2
from engine.pictures.color_fit import fit_colors
from engine.pictures.tone_curve import robust_regression

__all__ = ["ResidualConfig", "image_cotangent"]

_OPPONENT = np.array(
    [[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]], dtype=np.float32
)
"""Rows: Y, Cb, Cr of JPEG. JPEG treats brightness and chroma apart, and so must the weights."""

_SAMPLES = 100_000


@dataclass(frozen=True)
class ResidualConfig:
    """Knobs of `image_cotangent`.

    Parameters
    ----------
    levels : int
        Haar levels; blocks of 2^levels pixels are the coarsest details.
    tone_knots : int
        Knots of a channel's tone curve.
    least_slope : float
        Pixels with a channel of which less than this share of a change survives clipping are left out.
    noise_floor : float
        Standard deviation added to every band's, image units: about what rounding to 8 bits leaves.
    clip : float
        Coefficients are clipped at this many standard deviations of their band.
    exponent : float
        A band is divided by its variance to this power. 1 is right for noise that is independent of the mark;
        1/2 is kinder to lossy compression, whose most quiet bands are those it emptied of the mark.
    """

    levels: int = 5
    tone_knots: int = 9
    least_slope: float = 0.3
    noise_floor: float = 0.002
    clip: float = 3.0
    exponent: float = 0.5

    def __post_init__(self) -> None:
        if not 1 <= self.levels <= 10:
            raise InputError(f"levels must be 1 to 10, got {self.levels}")
        if self.noise_floor <= 0 or self.clip <= 0 or self.tone_knots < 2:
            raise InputError("noise_floor and clip must be positive and tone_knots at least 2")


def image_cotangent(
    reference_image: Float32, warped: Float32, mask: Bool, config: ResidualConfig = ResidualConfig()
) -> Float32:
    """Weighted residual of a picture, to be pulled back by the rasterizer's VJP.

    Parameters
    ----------
    reference_image : (H, W, 3) float32
        Render of the unmarked reference, 0..1.
    warped : (H, W, 3) float32
        The picture in the same pixels, 0..1.
    mask : (H, W) bool
        Pixels that carry evidence.

    Returns
    -------
    (H, W, 3) float32
        Zero outside the mask. All zeros when the mask holds too little to fit anything.

    Raises
    ------
    InputError
        If the shapes differ.
    """
    if reference_image.shape != warped.shape or reference_image.shape[:2] != mask.shape:
        raise InputError(f"shapes differ: {reference_image.shape}, {warped.shape}, mask {mask.shape}")
    if mask.sum() < 64:
        return np.zeros_like(reference_image, dtype=np.float32)
    reference = np.clip(reference_image, 0.0, 1.0).astype(np.float32)
    toned = fit_colors(reference, warped, mask, config.tone_knots)
    usable = mask & (toned.slope.min(axis=2) > config.least_slope)
    if usable.sum() < 64:
        return np.zeros_like(reference)
    residual = ((warped - toned.predicted) * usable[..., None]) @ _OPPONENT.T  # (H, W, 3): Y, Cb, Cr
    expected = toned.predicted @ _OPPONENT.T
    weighted = np.empty_like(residual)
    coverage = _coverage(usable, config.levels)
    for c in range(3):
        planes = [expected[..., 0]] if c == 0 else [expected[..., 0], expected[..., c]]
        clean = _take_off_shape(residual[..., c], planes, usable)
        weighted[..., c] = _whiten(clean, coverage, config)
    # The transpose of the change of colours, of the slope and of the mask: this is a cotangent.
    return np.ascontiguousarray((weighted @ _OPPONENT) * toned.slope * usable[..., None], dtype=np.float32)


def _take_off_shape(residual: Float32, planes: list[Float32], usable: Bool) -> Float32:
    """The residual less its regression on gradients, Laplacian and squared Laplacian of the reference."""
    columns = [np.ones_like(residual)]
    for plane in planes:
        gy, gx = (np.asarray(g) for g in np.gradient(plane))
        once = _laplacian(plane)
        columns += [gx, gy, once, _laplacian(once)]
    where = np.nonzero(usable.ravel())[0]
    where = where[:: max(1, len(where) // _SAMPLES)]
    design = np.stack([column.ravel()[where] for column in columns], axis=1)
    solution = robust_regression(design, residual.ravel()[where]).astype(np.float32)
    explained = sum((s * column for s, column in zip(solution, columns, strict=True)), np.float32(0.0))
    return np.asarray((residual - explained) * usable, dtype=np.float32)


def _laplacian(plane: Float32) -> Float32:
    padded = np.pad(plane, 1, mode="edge")
    return padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:] - 4.0 * plane


def _coverage(usable: Bool, levels: int) -> list[Float32]:
    """Per level, the share of each Haar block that is usable."""
    shares, share = [], usable.astype(np.float32)
    for _ in range(levels):
        share = dwt2(share, 1)[0] / 2.0
        shares.append(share)
    return shares


def _whiten(plane: Float32, coverage: list[Float32], config: ResidualConfig) -> Float32:
    """W^T D W of a plane: D divides each band by its own variance to the power `exponent`."""
    approx, details = dwt2(plane, config.levels)
    weighted = [
        tuple(_weigh(band, share[: band.shape[0], : band.shape[1]], config) for band in bands)
        for bands, share in zip(details, coverage, strict=True)
    ]
    return np.asarray(idwt2(_weigh(approx, coverage[-1], config), weighted))  # type: ignore[arg-type]


def _weigh(band: npt.NDArray[Any], share: Float32, config: ResidualConfig) -> Float32:
    count = max(float(share.sum()), 1.0)
    squares = np.square(band)
    variance = float(squares.sum()) / count
    for _ in range(4):  # outliers must not set the scale they are judged by
        variance = float(np.minimum(squares, config.clip**2 * variance).sum()) / count
    variance += config.noise_floor**2
    limit = config.clip * np.sqrt(variance)
    return np.asarray(np.clip(band, -limit, limit) / variance**config.exponent, dtype=np.float32)
