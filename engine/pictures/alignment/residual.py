"""What a picture says that the unmarked reference does not, weighted by how far it can be believed.

1. Colour: affine change, clipping, tone curve and uneven light are fitted and taken off (`fit_colors`).
2. Sharpness and position: the residual is regressed on gradients and Laplacians of the reference; what blur,
   resampling and a few hundredths of a pixel leave behind is explained by these.
3. Reliability: the residual's Haar bands, brightness and chroma apart, are weighed by their variance around each
   coefficient: noise, texture and edges that another renderer draws otherwise count little. Outliers are clipped. How
   much of the reference's own faint details a band still shows is how much of a mark's it would show. What a lossy
   coder emptied is quiet, and still counts little.

Everything depends on the picture and the unmarked reference alone: no key, no chip, no mark (DESIGN 4.9).
"""

from functools import reduce
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Bool, Float32, Float64
from engine.numerics.wavelet import dwt2, idwt2
from engine.pictures.alignment.config import CONFIG
from engine.pictures.alignment.tone_and_light import Toned, fit_colors, robust_regression

_CONFIG = CONFIG.residual
OPPONENT = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]], dtype=np.float32)
"""Rows: Y, Cb, Cr of JPEG. JPEG treats brightness and chroma apart, and so must the weights."""


def image_cotangent(
    reference_image: Float32, warped: Float32, mask: Bool, toned: Toned | None = None, *, planes: slice = slice(3)
) -> Float32:
    """(H, W, 3) weighted residual of a picture, to be pulled back by the rasterizer's VJP; zero outside the mask.

    `reference_image` is the render of the unmarked reference, `warped` the picture in the same pixels, both 0..1;
    `mask` (H, W) are the pixels that carry evidence: all zeros when it holds too little to fit anything. `toned` is the
    reference in the picture's colours, fitted here where it is not given; of brightness and both chromas the `planes`
    are read.
    InputError if the shapes differ.
    """
    if reference_image.shape != warped.shape or reference_image.shape[:2] != mask.shape:
        raise InputError(f"shapes differ: {reference_image.shape}, {warped.shape}, mask {mask.shape}")
    if mask.sum() < _CONFIG.least_pixels:
        return np.zeros_like(reference_image, dtype=np.float32)
    reference = np.clip(reference_image, 0.0, 1.0).astype(np.float32)
    toned = fit_colors(reference, warped, mask) if toned is None else toned
    usable = mask & (reduce(np.minimum, np.moveaxis(toned.slope, 2, 0)) > _CONFIG.least_slope)  # `min` is slow
    if usable.sum() < _CONFIG.least_pixels:
        return np.zeros_like(reference)
    residual = ((warped - toned.predicted) * usable[..., None]) @ OPPONENT.T  # (H, W, 3): Y, Cb, Cr
    expected = toned.predicted @ OPPONENT.T
    weighted = np.zeros_like(residual)
    coverage = _coverage(usable)
    for c in range(3)[planes]:
        shape = [expected[..., 0]] if c == 0 else [expected[..., 0], expected[..., c]]
        clean = _take_off_shape(residual[..., c], shape, usable)
        weighted[..., c] = _whiten(clean, residual[..., c], expected[..., c], coverage)
    # The transpose of the change of colours, of the slope and of the mask: this is a cotangent.
    return np.ascontiguousarray((weighted @ OPPONENT) * toned.slope * usable[..., None], dtype=np.float32)


def _take_off_shape(residual: Float32, planes: list[Float32], usable: Bool) -> Float32:
    """The residual less its regression on gradients, Laplacian and squared Laplacian of the reference."""
    columns = [np.ones_like(residual)]
    for plane in planes:
        gy, gx = (np.asarray(g) for g in np.gradient(plane))
        once = _laplacian(plane)
        columns += [gx, gy, once, _laplacian(once)]
    where = np.nonzero(usable.ravel())[0]
    where = where[:: max(1, len(where) // _CONFIG.samples)]
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
    for _ in range(_CONFIG.levels):
        share = dwt2(share, 1)[0] / 2.0
        shares.append(share)
    return shares


def _whiten(clean: Float32, residual: Float32, expected: Float32, coverage: list[Float32]) -> Float32:
    """W^T D W of a clean plane: D weighs each band by its variance, and by what it shows of the expected picture's."""
    approx, details = dwt2(clean, _CONFIG.levels)
    off, known = dwt2(residual, _CONFIG.levels)[1], dwt2(expected, _CONFIG.levels)[1]
    weighted = []
    for *levels, share in zip(details, off, known, coverage, strict=True):
        bands = zip(*levels, strict=True)  # of each direction: what is clean, what is off, what is known
        weighted.append(tuple(_weigh(a, _inside(share, a), _survival(b, c, _inside(share, a))) for a, b, c in bands))
    coarse = _weigh(approx, coverage[-1])
    return np.asarray(idwt2(coarse, weighted))  # type: ignore[arg-type]  # mypy does not count the three bands


def _inside(share: Float32, band: npt.NDArray[Any]) -> Float32:
    """The share of each block that is usable, for a band that lacks an odd last row or column."""
    return share[: band.shape[0], : band.shape[1]]


def _survival(off: npt.NDArray[Any], known: npt.NDArray[Any], share: Float32) -> float:
    """What the picture shows of the faint details of a band, 0 to 1.

    `off` is how far the picture is from the reference in that band, `known` the reference.
    """
    faint = (share > 0.99) & (np.abs(known) > _CONFIG.faint[0]) & (np.abs(known) < _CONFIG.faint[1])
    if faint.sum() < _CONFIG.least_details:
        return 1.0
    error, detail = off[faint].astype(np.float64), known[faint].astype(np.float64)
    limit = _CONFIG.clip * np.sqrt(np.square(error).mean())
    error, size = np.clip(error, -limit, limit), float(detail @ detail)
    slope = 1.0 + float(error @ detail) / size
    doubt = np.sqrt(np.square(error).mean() / size)  # of the slope
    return float(np.clip(slope + _CONFIG.doubts * doubt, 0.0, 1.0))


def _weigh(band: npt.NDArray[Any], share: Float32, kept: float = 1.0) -> Float32:
    """The band times the square of what it keeps of a faint detail, over its variance: around each coefficient, or, of
    an emptied band, as a whole and to the power `exponent`."""
    if not band.size:
        return band.astype(np.float32)
    count = max(float(share.sum()), 1.0)
    squares = np.square(band)
    variance = float(squares.sum()) / count
    for _ in range(4):  # outliers must not set the scale they are judged by
        variance = float(np.minimum(squares, _CONFIG.clip**2 * variance).sum()) / count
    noise, power = np.asarray(variance + _CONFIG.noise_floor**2), _CONFIG.exponent
    if kept >= _CONFIG.kept:
        noise = (_sums(squares) + _CONFIG.prior * variance) / (_sums(share) + _CONFIG.prior) + _CONFIG.noise_floor**2
        power = 1.0
    limit = _CONFIG.clip * np.sqrt(noise)
    return np.asarray(kept**2 * np.clip(band, -limit, limit) / noise**power, dtype=np.float32)


def _sums(plane: npt.NDArray[Any]) -> Float64:
    """Of the window around each coefficient; nothing lies outside."""
    import cv2  # loaded where a picture is read, not where a model is marked

    side = _CONFIG.window
    return np.asarray(cv2.boxFilter(plane, cv2.CV_64F, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT))
