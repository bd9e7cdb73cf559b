"""A JPEG coder's blocks: where they lie in a picture and at what quality, and what they say of a small change.

A coder works on blocks of 8x8 pixels that begin at a corner of what it was given. A cut through the decoded picture
moves that corner: the blocks then begin at any of 64 places. On the right one, and on no other, coefficients sit on the
multiples of a table.

What they say of a small change of the reference is the exact score of the quantizer. A coder rounds each DCT
coefficient of the luma to a multiple of its step q. Knowing the unmarked coefficient c, the observed multiple k tells
that c plus the mark's share d fell into [(k - 1/2) q, (k + 1/2) q]. With d normal with standard deviation s, the
locally optimal statistic is E[d | interval] / s^2, a truncated normal mean. A plain residual would take all of the
rounding error, known in advance from c, for noise.
"""

# mypy: allow-untyped-defs

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from engine.kernels.jit import parallel_kernel, share_of
from engine.model import Bool, Float32, Float64
from engine.pictures.alignment.tone_and_light import fit_colors
from engine.pictures.jpeg.config import CONFIG
from engine.pictures.landmarks.keypoints import LUMA

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
    return scaled_table(STANDARD_LUMA_TABLE, quality)


def scaled_table(standard: Float64, quality: int) -> Float64:
    """(8, 8) a standard table's steps as libjpeg scales them to a quality of 1 to 100."""
    factor = 5000 // quality if quality < 50 else 200 - 2 * quality
    return np.clip((standard * factor + 50) // 100, 1, 255)


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


def block_spread(pattern: Float32) -> Float64:
    """(by, bx, 8, 8) standard deviation of a mark-like pattern (H, W, 3) in each luma coefficient, grey levels.

    The spectrum is the whole picture's, its strength that of `nearby` blocks: a mark is loud here and silent there.
    """
    return mark_spread(blocks_of(255.0 * pattern @ LUMA + 128.0))


def mark_spread(coefficients: Float64) -> Float64:
    """As `block_spread`, of a pattern's coefficients (by, bx, 8, 8) in any plane."""
    power = np.square(coefficients)
    local = power.mean(axis=(2, 3))
    loudness = np.maximum(scipy.ndimage.uniform_filter(local, CONFIG.nearby), 0.0) / max(float(local.mean()), 1e-30)
    return np.asarray(np.sqrt(power.mean(axis=(0, 1)) * loudness[:, :, None, None]))


def jpeg_cotangent(reference: Float32, picture: Float32, mask: Bool, spread: Float64, quality: int) -> Float32:
    """(H, W, 3) cotangent image, log-likelihood per unit of colour, of a JPEG-compressed suspect pixel on pixel over
    the reference.

    `reference` is the unmarked render with the suspect's exposure (`match_exposure`), `picture` the suspect, never
    resampled since it was compressed, both 0..1; blocks that touch pixels outside `mask` are left out; `spread`, (8, 8)
    or (by, bx, 8, 8), is the mark's standard deviation in each coefficient, grey levels; `quality` comes from
    `find_quality`. Luma alone: chroma is read by `CodedChroma`, or by `image_cotangent`.
    """
    observed = blocks_of(255.0 * picture @ LUMA)
    steps = luma_table(quality)
    known = blocks_of(255.0 * reference @ LUMA)
    total = np.sqrt(spread**2 + CONFIG.rounding**2 + _mismatch(observed, known, steps) ** 2)
    whole = np.asarray(tiles(mask).all(axis=(2, 3)))  # (by, bx)
    score = np.zeros_like(known)
    multiples = _multiples(observed[whole], known[whole], steps)
    score[whole] = score_intervals(multiples, known[whole], steps, np.broadcast_to(total, known.shape)[whole])
    image = np.zeros(mask.shape, dtype=np.float32)
    tiles(image)[...] = inverse_transform(score)
    return (255.0 * image[:, :, None] * LUMA).astype(np.float32)


def score_intervals(k: Float64, known: Float64, steps: Float64, total: Float64) -> Float64:
    """(..., 8, 8) score of the multiples k that a coder stored, where it was expected to see `known`, with `total` the
    standard deviation of all that may differ."""
    low, high = ((k - 0.5) * steps - known) / total, ((k + 0.5) * steps - known) / total
    score = _truncated_mean(low, high) / total
    # A coefficient many deviations from where the reference puts it is something else in the picture.
    score[(np.minimum(np.abs(low), np.abs(high)) > 4.0) & (low * high > 0)] = 0.0
    return score


def agreement(reference: Float32, picture: Float32, mask: Bool, quality: int) -> float:
    """Share, 0 to 1, of a JPEG-compressed picture's multiples that its coder would have stored of the reference, too.

    Of those that are not zero in both; 0 where there is none. All as in `jpeg_cotangent`.

    It falls where the two are out of register by a tenth of a pixel, of which the brightness of what quality 10 left
    tells little.
    """
    steps = luma_table(quality)
    known = blocks_of(255.0 * reference @ LUMA)
    k = _multiples(blocks_of(255.0 * picture @ LUMA), known, steps)
    would = np.round(known / steps)
    counted = ((k != 0) | (would != 0)) & np.asarray(tiles(mask).all(axis=(2, 3)))[:, :, None, None]
    counted[:, :, 0, 0] = False  # the block's brightness, which hardly moves
    return float((k == would)[counted].mean()) if counted.any() else 0.0


def _multiples(observed: Float64, known: Float64, steps: Float64) -> Float64:
    """Multiples of the steps that the coder stored, also in blocks whose decoded pixels were clipped.

    Clipping to black or white moves every coefficient of a block off its multiple. The reference, coded and clipped
    alike, is moved alike, so multiples are counted from there.
    """
    start = np.round(known / steps)
    decoded = np.clip(inverse_transform(start * steps), -128.0, 127.0)
    return np.asarray(start + np.round((observed - transform(decoded)) / steps))


def as_jpeg(picture: Float32, quality: int) -> Float32:
    """A picture (H, W, 3), clipped to 0..1, as a JPEG of it is decoded."""
    import cv2

    stored = np.round(np.clip(picture[..., ::-1], 0.0, 1.0) * 255.0).astype(np.uint8)
    coded = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    decoded = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), dtype=np.float32)
    return decoded[..., ::-1] / np.float32(255.0)


def match_exposure(reference: Float32, picture: Float32, mask: Bool, quality: int) -> Float32:
    """The reference in the colours of a picture that was coded at this quality, where these are not its own.

    Gain and offset of each channel tell whether they are, also against the reference coded alike: a coarse coder rounds
    little chroma to none, which is no exposure. Tone and light are fitted in full only where that explains clearly
    more. All on block means: compression takes contrast from single pixels, too, and a tone curve would bend to it.
    """
    use = unclipped(picture) & tiles(mask).all(axis=(2, 3))
    if use.sum() < 50:
        return reference
    out = np.clip(reference, 0.0, 1.0)
    changes = _exposure(reference, picture, use)
    if not changes or not _exposure(as_jpeg(reference, quality), picture, use):
        return out
    for c, (gain, offset) in changes.items():
        out[..., c] = np.clip(gain * reference[..., c] + offset, 0.0, 1.0)
    full = fit_colors(reference, picture, mask).predicted
    missed, left = (_missed(image, picture, use) for image in (out, full))
    return full if left < CONFIG.better * missed else out


def _exposure(reference: Float32, picture: Float32, use: Bool) -> dict[int, tuple[float, float]]:
    """Gain and offset of each channel that has clearly changed."""
    changes = dict[int, tuple[float, float]]()
    for c in range(3):
        x, y = (_block_means(image[..., c])[use] for image in (reference, picture))
        gain, offset = 1.0, 0.0
        for _ in range(6):
            w = 1.0 / (1.0 + np.square((y - gain * x - offset) / 0.03))
            mean_x, mean_y = np.average(x, weights=w), np.average(y, weights=w)
            gain = float(np.sum(w * (x - mean_x) * (y - mean_y)) / max(np.sum(w * np.square(x - mean_x)), 1e-12))
            offset = float(mean_y - gain * mean_x)
        changed = abs(gain - 1.0) > 0.03 or abs(offset) > 0.012
        sane = 0.2 < gain < 5.0 and abs(offset) < 0.3  # too flat a picture fits any line
        if changed and sane:
            changes[c] = gain, offset
    return changes


def _missed(predicted: Float32, picture: Float32, use: Bool) -> float:
    """Median error of the block means."""
    errors = [np.abs(_block_means(picture[..., c]) - _block_means(predicted[..., c]))[use] for c in range(3)]
    return float(np.median(errors))


def _block_means(plane: Float32) -> Float64:
    return np.asarray(tiles(plane).swapaxes(1, 2).mean(axis=(1, 3), dtype=np.float64))


def _mismatch(observed: Float64, known: Float64, steps: Float64) -> Float64:
    """(8, 8) deviation of the suspect from the reference beyond what rounding to the steps explains."""
    error = np.square(observed - known).reshape(-1, 64)  # (B, 64)
    typical = np.mean(np.minimum(error, 9.0 * np.quantile(error, 0.9, axis=0)), axis=0).reshape(8, 8)
    return np.asarray(np.sqrt(np.maximum(typical - steps**2 / 12.0, 0.0)) * 0.5)


def _truncated_mean(low: Float64, high: Float64) -> Float64:
    """Mean of a standard normal known to lie in [low, high], stable in the tails."""
    flip = low + high > 0  # by symmetry work in the lower tail
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    lower, upper = scipy.special.log_ndtr(a), scipy.special.log_ndtr(b)
    log_mass = upper + np.log1p(-np.exp(np.minimum(lower - upper, -1e-12)))
    density = np.exp(-0.5 * a**2 - log_mass) - np.exp(-0.5 * b**2 - log_mass)
    mean = density / np.sqrt(2 * np.pi)
    return np.asarray(np.where(flip, -mean, mean))


_WAVES: Float64 = np.sqrt((1 + (np.arange(8) > 0)) / 8.0)[:, None] * np.cos(
    np.pi / 16.0 * np.outer(np.arange(8), 2 * np.arange(8) + 1)
)
"""(8, 8) of each frequency the eight values of its wave."""


def transform(blocks: npt.NDArray[np.floating]) -> Float64:
    """Coefficients (..., 8, 8) of blocks of pixels (..., 8, 8), the slowest first."""
    return _turned(blocks, _WAVES)


def inverse_transform(coefficients: Float64) -> Float64:
    """Pixels (..., 8, 8) of blocks of coefficients (..., 8, 8)."""
    return _turned(coefficients, _WAVES.T)


def _turned(blocks: npt.NDArray[np.floating], waves: Float64) -> Float64:
    """waves @ block @ waves.T of each, as two products over all blocks. Importing `scipy.fft` instead takes 0.16 of the
    1.8 CPU seconds in which a picture is verified."""
    rows = np.asarray(blocks, dtype=np.float64).reshape(-1, 8) @ waves.T
    columns = rows.reshape(-1, 8, 8).swapaxes(1, 2).reshape(-1, 8) @ waves.T
    return np.ascontiguousarray(columns.reshape(-1, 8, 8).swapaxes(1, 2)).reshape(blocks.shape)
