"""What a JPEG coder stored of a picture's chroma, and what that says of a small change of the reference.

A coder halves both chroma planes and rounds their DCT coefficients to multiples of a table's steps; a decoder doubles
them again by a triangle (libjpeg's "fancy" upsampling), which is undone here exactly. In the halves, most multiples are
zero, of what was there before: a plain residual takes all that the coder left out for noise, and the quieter a place,
the more it trusts it. The score of the quantizer's intervals knows better.

The picture may be another renderer's, whose error is as large as the steps: it is measured for each coefficient, and
around each block, beside the rounding that follows from the reference. Nothing here sees a key or a chip.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from engine.model import Bool, Float32, Float64
from engine.pictures.alignment.residual import OPPONENT
from engine.pictures.jpeg.coded_blocks import (
    inverse_transform,
    mark_spread,
    scaled_table,
    score_intervals,
    tiles,
    transform,
)
from engine.pictures.jpeg.config import CONFIG

STANDARD_CHROMA_TABLE = np.full((8, 8), 99.0)
"""ITU-T T.81, table K.2."""
STANDARD_CHROMA_TABLE[:4, :4] = [[17, 18, 24, 47], [18, 21, 26, 66], [24, 26, 56, 99], [47, 66, 99, 99]]


@dataclass(frozen=True, eq=False)
class CodedChroma:
    """Both chroma planes of a picture (H, W, 3) at half its size, as its coder stored them."""

    size: tuple[int, int]  # H, W
    first: tuple[int, int]  # row and column of the first whole block, pixels of half the size: 0 or 4
    steps: Float64  # (8, 8)
    stored: Float64  # (2, by, bx, 8, 8) Cb and Cr, multiples of the steps, gray levels
    spread: Float64  # (2, by, bx, 8, 8) the mark's standard deviation in each, gray levels
    whole: Bool  # (2, by, bx, 8, 8) those in blocks that carry evidence, and on a multiple

    @classmethod
    def of(cls, picture: Float32, mask: Bool, pattern: Float32, quality: int) -> "CodedChroma | None":
        """What a coder stored of a picture (H, W, 3), 0..1, whose luma it saved at a quality, in blocks that begin at
        the corner; None where no halves on that quality's steps explain the chroma.

        `mask` (H, W) are the pixels that carry evidence, `pattern` (H, W, 3) is what a mark of public signs adds.
        """
        if min(mask.shape) < 32:
            return None
        steps = scaled_table(STANDARD_CHROMA_TABLE, quality)
        planes = [_undoubled(255.0 * picture @ OPPONENT[c]) for c in (1, 2)]
        least, best = CONFIG.chroma_off, None
        for first in ((0, 0), (0, 4), (4, 0), (4, 4)):  # luma's blocks tell where chroma's begin up to 8 pixels
            multiples = np.stack([_blocks(plane, first) for plane in planes]) / steps
            off = np.abs(multiples - np.round(multiples))
            loud = np.abs(multiples) > 0.6  # zeros fit every table
            if loud.sum() >= CONFIG.chroma_loud and off[loud].mean() < least:
                least, best = float(off[loud].mean()), (first, multiples, off)
        if best is None:
            return None
        first, multiples, off = best
        inside = (_blocks(_halved(mask.astype(np.float32)), first, plain=True) == 1.0).all(axis=(2, 3))
        spread = [mark_spread(_blocks(_halved(255.0 * pattern @ OPPONENT[c]), first)) for c in (1, 2)]
        # What was clipped, or drawn over later, lies off the multiples.
        whole = inside[None, :, :, None, None] & (off < 0.25)
        return cls(mask.shape, first, steps, np.round(multiples) * steps, np.stack(spread), whole)

    def cotangent(self, reference: Float32) -> Float32:
        """(H, W, 3) log-likelihood per unit of color of the picture over the reference in its colors (H, W, 3)."""
        image = np.zeros((*self.size, 3), dtype=np.float32)
        rows, columns = self.size[0] // 2, self.size[1] // 2
        for c, stored, spread, whole in zip((1, 2), self.stored, self.spread, self.whole, strict=True):
            known = _blocks(_halved(255.0 * reference @ OPPONENT[c]), self.first)
            total = np.sqrt(spread**2 + CONFIG.rounding**2 + _renderer_error(stored, known, self.steps, whole))
            score = np.where(whole, score_intervals(stored / self.steps, known, self.steps, total), 0.0)
            half = np.zeros((rows, columns), dtype=np.float32)
            tiles(half[self.first[0] :, self.first[1] :])[...] = inverse_transform(score)
            # A pixel is a quarter of one of half the size.
            doubled = np.repeat(np.repeat(255.0 / 4.0 * half, 2, axis=0), 2, axis=1)[..., None]
            image[: 2 * rows, : 2 * columns] += (doubled * OPPONENT[c]).astype(np.float32)
        return image


def _renderer_error(stored: Float64, known: Float64, steps: Float64, whole: Bool) -> Float64:
    """(by, bx, 8, 8) variance about the reference of what the picture was before it was coded: each coefficient's,
    times how loud the blocks around are, beside the rounding that the reference itself would have got."""
    square = np.square(stored - known)
    count = np.maximum(whole.sum(axis=(0, 1)), 1)
    typical = (square * whole).sum(axis=(0, 1)) / count
    limit = 9.0 * np.maximum(typical, CONFIG.rounding**2)  # outliers must not set the scale
    beyond = (np.minimum(square, limit) - np.square(np.round(known / steps) * steps - known)) * whole
    variance = np.maximum(beyond.sum(axis=(0, 1)) / count, 0.0)
    seen = variance > 0.2 * CONFIG.rounding**2
    if not seen.any():
        return np.broadcast_to(variance, known.shape)
    loud = (beyond[..., seen] / variance[seen]).sum(axis=-1)
    near, there = (
        scipy.ndimage.uniform_filter(each, CONFIG.chroma_nearby)
        for each in (loud, whole[..., seen].sum(axis=-1, dtype=np.float64))
    )
    return np.asarray(variance * np.maximum(near / np.maximum(there, 1.0), CONFIG.chroma_quiet)[..., None, None])


def _undoubled(plane: Float32) -> Float64:
    """(h, w) the plane of which a decoder made one of twice the size (H, W): each of its pixels is three parts the
    nearest and one part the next, along either axis."""

    def along(doubled: Float64) -> Float64:
        pairs = doubled.reshape(-1, 2, doubled.shape[1]).sum(axis=1)
        bands = np.full((3, len(pairs)), 0.25)
        bands[1] = 1.5
        bands[1, [0, -1]] += 0.25  # at the border, the nearest is the next, too
        return np.asarray(scipy.linalg.solve_banded((1, 1), bands, pairs))

    height, width = (side // 2 * 2 for side in plane.shape)
    return along(along(plane[:height, :width].astype(np.float64)).T).T


def _halved(plane: Float32) -> Float64:
    """(h, w) as a coder halves a plane (H, W)."""
    height, width = (side // 2 for side in plane.shape)
    return np.asarray(plane[: 2 * height, : 2 * width].reshape(height, 2, width, 2).mean(axis=(1, 3), dtype=np.float64))


def _blocks(plane: Float64, first: tuple[int, int], *, plain: bool = False) -> Float64:
    """(by, bx, 8, 8) orthonormal DCT of the whole blocks of a plane (h, w) from the first on; `plain`: their pixels."""
    blocks = tiles(plane[first[0] :, first[1] :])
    return np.asarray(blocks) if plain else transform(np.ascontiguousarray(blocks))
