"""Where a JPEG coder's blocks lie in a picture, and at what quality it was saved, from the pixels alone.

A coder works on blocks of 8x8 pixels that begin at a corner of what it was given. A cut through the decoded picture
moves that corner: the blocks then begin at any of 64 places. On the right one, and on no other, coefficients sit on the
multiples of a table.
"""

# mypy: allow-untyped-defs

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.kernels.jit import parallel_kernel, share_of
from engine.model import Bool, Float32, Float64
from engine.pictures.jpeg.block_transform import transform
from engine.pictures.jpeg.config import CONFIG
from engine.pictures.landmarks.keypoints import LUMA

__all__ = ["JpegGrid", "blocks_of", "find_grid", "find_quality", "luma_table", "tiles", "unclipped"]

STANDARD_LUMA_TABLE = np.array(
    [
        [16, 11, 10, 16, 24, 40, 51, 61],
        [12, 12, 14, 19, 26, 58, 60, 55],
        [14, 13, 16, 24, 40, 57, 69, 56],
        [14, 17, 22, 29, 51, 87, 80, 62],
        [18, 22, 37, 56, 68, 109, 103, 77],
        [24, 35, 55, 64, 81, 104, 113, 92],
        [49, 64, 78, 87, 103, 121, 120, 101],
        [72, 92, 95, 98, 112, 100, 103, 99],
    ],
    dtype=np.float64,
)
"""ITU-T T.81, table K.1: what libjpeg scales by quality, and so nearly every encoder."""

LEAST_STEP = CONFIG.least_step
_QUALITIES = range(CONFIG.qualities[0], CONFIG.qualities[1] + 1)


@dataclass(frozen=True)
class JpegGrid:
    """A coder's blocks in a decoded picture."""

    quality: int  # of libjpeg, 1 to 100
    top: int  # rows above the first whole block, 0 to 7
    left: int  # columns before it

    def part(self, image: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The image (H, W, ...) from the first whole block on, a view."""
        return image[self.top :, self.left :]

    def whole(self, part: Float32, shape: tuple[int, ...]) -> Float32:
        """What was made of `part`, with zeros around it up to an image of this shape."""
        image = np.zeros(shape, dtype=np.float32)
        self.part(image)[...] = part
        return image


def luma_table(quality: int) -> Float64:
    """(8, 8) quantisation steps of libjpeg at a quality of 1 to 100."""
    factor = 5000 // quality if quality < 50 else 200 - 2 * quality
    return np.clip((STANDARD_LUMA_TABLE * factor + 50) // 100, 1, 255)


def tiles(pixels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(by, bx, 8, 8, ...) the whole blocks of an image (H, W, ...), a view."""
    by, bx = pixels.shape[0] // 8, pixels.shape[1] // 8
    return pixels[: 8 * by, : 8 * bx].reshape(by, 8, bx, 8, *pixels.shape[2:]).swapaxes(1, 2)


def blocks_of(luma: Float32 | Float64) -> Float64:
    """(by, bx, 8, 8) orthonormal DCT of whole 8x8 blocks of a luma picture in grey levels."""
    return transform(tiles(luma).astype(np.float64) - 128.0)


def unclipped(picture: Float32) -> Bool:
    """(by, bx) blocks without black or white values."""
    return np.asarray(tiles((picture > 1.5 / 255.0) & (picture < 253.5 / 255.0)).all(axis=(2, 3, 4)))


def find_grid(picture: Float32) -> JpegGrid | None:
    """The blocks of the coder that a picture (H, W, 3), 0..1, came from, wherever they begin.

    None as in `find_quality`.
    """
    if not _is_decoded(picture):
        return None
    quality = find_quality(picture)
    if quality is not None:
        return JpegGrid(quality, 0, 0)
    luma = 255.0 * picture @ LUMA
    places = [(top, left) for top in range(8) for left in range(8) if top or left]
    likely = sorted(places, key=lambda place: -_emptiness(luma[place[0] :, place[1] :]))
    for top, left in likely[: CONFIG.places]:
        quality = find_quality(picture[top:, left:])
        if quality is not None:
            return JpegGrid(quality, top, left)
    return None


def _emptiness(luma: Float32 | Float64) -> float:
    """Share of the coefficients of some blocks in which a coder may have stored nothing, of blocks that show anything:
    on a wrong grid what is next to a block's edge fills them."""
    blocks = tiles(luma).reshape(-1, 8, 8)
    blocks = blocks[:: max(1, len(blocks) // CONFIG.sampled)]
    blocks = blocks[np.ptp(blocks, axis=(1, 2)) > 4.0 * CONFIG.empty]
    if not len(blocks):
        return 0.0
    return float((np.abs(transform(blocks)) < CONFIG.empty).mean())


def find_quality(picture: Float32) -> int | None:
    """libjpeg quality a picture (H, W, 3), 0..1, was saved at, judged by how its coefficients sit on a table's
    multiples; its blocks begin at its corner.

    None where no quality in `qualities` explains the coefficients (never compressed, resampled since, or compressed too
    lightly to matter).
    """
    if not _is_decoded(picture):
        return None
    chosen = np.flatnonzero(unclipped(picture).ravel())  # clipping moves coefficients off their multiples
    if len(chosen) < 40:
        return None
    chosen = chosen[:: max(1, len(chosen) // CONFIG.blocks)]
    blocks = tiles(255.0 * picture @ LUMA)
    flat = transform(blocks[np.divmod(chosen, blocks.shape[1])])
    coefficients = np.ascontiguousarray(flat.reshape(len(chosen), 64)[:, 1 : CONFIG.coarsest].T)
    tables = np.stack([luma_table(quality).reshape(-1)[1 : CONFIG.coarsest] for quality in _QUALITIES])
    fits = np.empty(len(tables))
    _fit_tables(coefficients, tables, fits)
    best, least = None, 0.5
    for quality, fit in zip(_QUALITIES, fits, strict=True):
        # The steps of a finer table may divide the true ones: it must fit clearly better than a coarser one.
        if fit < 0.7 * least:
            best, least = quality, float(fit)
    return best


@parallel_kernel
def _fit_tables(coefficients, tables, fits, call):
    """How far coefficients (K, B) are off the multiples of tables (Q, K), in what they would be off any others: `fits`
    (Q,), infinite where too few coefficients say something."""
    for q in share_of(tables.shape[0], call):
        off = expected = 0.0
        used = busy = 0
        for k in range(tables.shape[1]):
            step = tables[q, k]
            if step < LEAST_STEP:
                continue
            used += 1
            loud = 0
            for b in range(coefficients.shape[1]):
                multiple = coefficients[k, b] / step
                if abs(multiple) > 0.6:  # zeros fit every table
                    loud += 1
                    off += ((multiple - np.rint(multiple)) * step) ** 2
            # On the right table what is left is rounding noise; on a wrong one it is uniform over the step.
            expected += loud * step * step / 12.0
            if loud > 4:
                busy += 1
        fits[q] = off / expected if used >= 6 and busy >= 3 else np.inf


def _is_decoded(picture: Float32) -> bool:
    """Whether all values are those of 8 bits, as any decoder writes them: a render or what was resampled is not."""
    levels = 255.0 * picture[:: max(1, len(picture) // CONFIG.decoded_rows)]
    return bool(np.abs(levels - np.rint(levels)).max() < 0.01)
