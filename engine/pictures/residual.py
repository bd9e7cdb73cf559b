"""What a picture says that the unmarked reference does not, weighted by how far it can be believed.

1. Colour: affine change, clipping, tone curve and uneven light are fitted and taken off (`light.fit_colors`).
2. Sharpness and position: the residual is regressed on gradients and Laplacians of the reference; what blur,
   resampling and a few hundredths of a pixel leave behind is explained by these.
3. Reliability: the residual's Haar bands, brightness and chroma apart, are divided by their own spread, so
   that bands drowned in noise or texture count little; outliers are clipped.

Everything depends on the picture and the unmarked reference alone: no key, no chip, no mark (DESIGN 4.9).
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Bool, Float32
from engine.numerics.wavelet import dwt2, idwt2
from engine.pictures.light import fit_colors
from engine.pictures.tone_curve import robust_regression

__all__ = ["image_cotangent"]

_OPPONENT = np.array(
    [[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]], dtype=np.float32
)
"""Rows: Y, Cb, Cr of JPEG. JPEG treats brightness and chroma apart, and so must the weights."""

_SAMPLES = 100_000


_LEVELS = 5
"""Haar levels; blocks of 2^5 pixels are the coarsest details."""
_LEAST_SLOPE = 0.3
"""Pixels with a channel of which less than this share of a change survives clipping are left out."""
_LEAST_PIXELS = 64
"""Fewer than this do not carry the fits."""
_NOISE_FLOOR = 0.002
"""Standard deviation added to every band's, image units: about what rounding to 8 bits leaves."""
_CLIP = 3.0
"""Coefficients are clipped at this many standard deviations of their band."""
_EXPONENT = 0.5
"""A band is divided by its variance to this power. 1 is right for noise that is independent of the mark; 1/2 is kinder
to lossy compression, whose most quiet bands are those it emptied of the mark."""


def image_cotangent(reference_image: Float32, warped: Float32, mask: Bool) -> Float32:
    """(H, W, 3) weighted residual of a picture, to be pulled back by the rasterizer's VJP; zero outside the mask.

    `reference_image` is the render of the unmarked reference, `warped` the picture in the same pixels, both 0..1;
    `mask` (H, W) are the pixels that carry evidence: all zeros when it holds too little to fit anything. InputError if
    the shapes differ.
    """
    if reference_image.shape != warped.shape or reference_image.shape[:2] != mask.shape:
        raise InputError(f"shapes differ: {reference_image.shape}, {warped.shape}, mask {mask.shape}")
    if mask.sum() < _LEAST_PIXELS:
        return np.zeros_like(reference_image, dtype=np.float32)
    reference = np.clip(reference_image, 0.0, 1.0).astype(np.float32)
    toned = fit_colors(reference, warped, mask)
    usable = mask & (toned.slope.min(axis=2) > _LEAST_SLOPE)
    if usable.sum() < _LEAST_PIXELS:
        return np.zeros_like(reference)
    residual = ((warped - toned.predicted) * usable[..., None]) @ _OPPONENT.T  # (H, W, 3): Y, Cb, Cr
    expected = toned.predicted @ _OPPONENT.T
    weighted = np.empty_like(residual)
    coverage = _coverage(usable)
    for c in range(3):
        planes = [expected[..., 0]] if c == 0 else [expected[..., 0], expected[..., c]]
        clean = _take_off_shape(residual[..., c], planes, usable)
        weighted[..., c] = _whiten(clean, coverage)
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
    design = np.stack([column.ravel()[where] for column in columns], axis=1)  # (P, K)
    solution = robust_regression(design, residual.ravel()[where]).astype(np.float32)
    explained = sum((s * column for s, column in zip(solution, columns, strict=True)), np.float32(0.0))
    return np.asarray((residual - explained) * usable, dtype=np.float32)


def _laplacian(plane: Float32) -> Float32:
    padded = np.pad(plane, 1, mode="edge")
    return padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:] - 4.0 * plane


def _coverage(usable: Bool) -> list[Float32]:
    """Per level, the share of each Haar block that is usable."""
    shares, share = [], usable.astype(np.float32)
    for _ in range(_LEVELS):
        share = dwt2(share, 1)[0] / 2.0
        shares.append(share)
    return shares


def _whiten(plane: Float32, coverage: list[Float32]) -> Float32:
    """W^T D W of a plane: D divides each band by its own variance to the power _EXPONENT."""
    approx, details = dwt2(plane, _LEVELS)
    weighted = [
        tuple(_weigh(band, share[: band.shape[0], : band.shape[1]]) for band in bands)
        for bands, share in zip(details, coverage, strict=True)
    ]
    coarse = _weigh(approx, coverage[-1])
    return np.asarray(idwt2(coarse, weighted))  # type: ignore[arg-type]  # mypy does not count the three bands


def _weigh(band: npt.NDArray[Any], share: Float32) -> Float32:
    count = max(float(share.sum()), 1.0)
    squares = np.square(band)
    variance = float(squares.sum()) / count
    for _ in range(4):  # outliers must not set the scale they are judged by
        variance = float(np.minimum(squares, _CLIP**2 * variance).sum()) / count
    variance += _NOISE_FLOOR**2
    limit = _CLIP * np.sqrt(variance)
    return np.asarray(np.clip(band, -limit, limit) / variance**_EXPONENT, dtype=np.float32)
