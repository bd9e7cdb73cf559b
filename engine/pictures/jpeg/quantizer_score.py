"""What a JPEG-compressed picture says about a small change of the reference: the exact score of its quantiser.

A JPEG coder rounds each DCT coefficient of the luma to a multiple of its step q. Knowing the unmarked coefficient
c, the observed multiple k tells that c plus the mark's share d fell into [(k - 1/2) q, (k + 1/2) q]. With d normal
with standard deviation s, the locally optimal statistic is E[d | interval] / s^2, a truncated normal mean. A plain
residual would take all of the rounding error, known in advance from c, for noise.
"""

import numpy as np
import scipy

from engine.model import Bool, Float32, Float64
from engine.pictures.alignment.uneven_light import fit_colors
from engine.pictures.jpeg.block_grid import blocks_of, luma_table, tiles, unclipped
from engine.pictures.jpeg.block_transform import inverse_transform, transform
from engine.pictures.jpeg.config import CONFIG
from engine.pictures.landmarks.keypoints import LUMA


def block_spread(pattern: Float32) -> Float64:
    """(by, bx, 8, 8) standard deviation of a mark-like pattern (H, W, 3) in each luma coefficient, grey levels.

    The spectrum is the whole picture's, its strength that of `nearby` blocks: a mark is loud here and silent there.
    """
    power = np.square(blocks_of(255.0 * pattern @ LUMA + 128.0))
    local = power.mean(axis=(2, 3))
    loudness = np.maximum(scipy.ndimage.uniform_filter(local, CONFIG.nearby), 0.0) / max(float(local.mean()), 1e-30)
    return np.asarray(np.sqrt(power.mean(axis=(0, 1)) * loudness[:, :, None, None]))


def jpeg_cotangent(reference: Float32, picture: Float32, mask: Bool, spread: Float64, quality: int) -> Float32:
    """(H, W, 3) cotangent image, log-likelihood per unit of colour, of a JPEG-compressed suspect pixel on pixel over
    the reference.

    `reference` is the unmarked render with the suspect's exposure (`match_exposure`), `picture` the suspect, never
    resampled since it was compressed, both 0..1; blocks that touch pixels outside `mask` are left out; `spread`, (8, 8)
    or (by, bx, 8, 8), is the mark's standard deviation in each coefficient, grey levels; `quality` comes from
    `find_quality`. Luma alone: coders keep little of chroma, and `image_cotangent` reads that.
    """
    observed = blocks_of(255.0 * picture @ LUMA)
    steps = luma_table(quality)
    known = blocks_of(255.0 * reference @ LUMA)
    total = np.sqrt(spread**2 + CONFIG.rounding**2 + _mismatch(observed, known, steps) ** 2)
    whole = np.asarray(tiles(mask).all(axis=(2, 3)))  # (by, bx)
    score = np.zeros_like(known)
    score[whole] = _score(observed[whole], known[whole], steps, np.broadcast_to(total, known.shape)[whole])
    image = np.zeros(mask.shape, dtype=np.float32)
    tiles(image)[...] = inverse_transform(score)
    return (255.0 * image[:, :, None] * LUMA).astype(np.float32)


def _score(observed: Float64, known: Float64, steps: Float64, total: Float64) -> Float64:
    """(B, 8, 8) of blocks: how much likelier each unit of colour makes what was stored, `total` the spread of it."""
    k = _multiples(observed, known, steps)
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


def match_exposure(reference: Float32, picture: Float32, mask: Bool) -> Float32:
    """The reference in the picture's colours, where these are not its own.

    Gain and offset of each channel tell whether they are; tone and light are fitted in full only where that explains
    clearly more. All on block means: compression takes contrast from single pixels, which is no exposure, but a
    tone curve would bend to it.
    """
    use = unclipped(picture) & tiles(mask).all(axis=(2, 3))
    if use.sum() < 50:
        return reference
    out = reference.copy()
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
            out[..., c] = gain * reference[..., c] + offset
    out = np.clip(out, 0.0, 1.0)
    if np.array_equal(out, np.clip(reference, 0.0, 1.0)):
        return out
    full = fit_colors(reference, picture, mask).predicted
    missed, left = (_missed(image, picture, use) for image in (out, full))
    return full if left < CONFIG.better * missed else out


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
