"""Pass 1: Gaussians to the image plane, sixteen at a time.

Writes one record of `RECORD` floats per visible Gaussian, at the Gaussian's own index (so no pass needs a
map):

    u, v               centre, pixels
    a, b, c, l         alpha = 2^q with q = a dx^2 + b dx dy + c dy^2 + l (a, c < 0; l = log2 of the opacity)
    slope_x, slope_y   for a given dy, q peaks at dx = slope_x dy; for a given dx, at dy = slope_y dx

and, for the later passes, the half extents of {alpha >= alpha_skip}, the rectangle of tiles they touch, which tiles of
it the ellipse reaches where it is small, and a compact list (depth, index) per chunk. The extent follows from opacity
and threshold exactly, so tight lists change no pixel.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math

import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.model import Camera, Float32
from engine.raster.lane_math import cross, dot, exp2, log2, row_times, scale_columns
from engine.raster.lane_memory import load, lowest_bit, store
from engine.raster.lane_order import unzip3, unzip4
from engine.raster.lanes import bits_of, maximum, minimum, root, round_down, select, spread
from engine.raster.settings import FRUSTUM_MARGIN, MAX_SIGMA_PX, TILE, RasterSettings

RECORD = 8
"""Floats per record."""

COVER = 4
"""Sides of the largest rectangle of tiles that is stored as bits: one of 16 for each tile, row by row."""

LANE_SCRATCH = 17 * 16
"""Floats of scratch a chunk needs."""

_f = np.float32
_i = np.int32
_LOG2_E = _f(math.log2(math.e))
_MAX_VARIANCE = _f(MAX_SIGMA_PX**2)
_TILES_PER_PIXEL = _f(1.0 / TILE)
_LARGEST_EXPONENT = _f(126.0)
_LEAST_SHARPNESS = _f(1e-6)
"""Of the determinant without the low pass, in that with it: float32 has no better."""


def pack_lens(camera: Camera, settings: RasterSettings) -> Float32:
    """Camera and settings as the flat float32 array that the kernels unpack.

    Rotation (9), translation (3), fx, fy, cx, cy, the four limits of x/z and y/z for the Jacobian
    (right, left, bottom, top), width, height, eps2d, near, log2 of the smallest alpha, tiles per row and
    column, 1 where opacity falls with the low pass, 1 where they are sorted by distance. Skew is in the first row of
    the rotation and the translation.
    """
    R, t, K = camera.viewmat[:3, :3].copy(), camera.viewmat[:3, 3].copy(), camera.K
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    R[0], t[0] = R[0] + K[0, 1] / fx * R[1], t[0] + K[0, 1] / fx * t[1]
    w, h = camera.width, camera.height
    margin_x, margin_y = FRUSTUM_MARGIN * 0.5 * w / fx, FRUSTUM_MARGIN * 0.5 * h / fy
    limits = [(w - cx) / fx + margin_x, -cx / fx - margin_x, (h - cy) / fy + margin_y, -cy / fy - margin_y]
    numbers = [*R.ravel(), *t, fx, fy, cx, cy, *limits, w, h, settings.eps2d, settings.near]
    numbers += [settings.log2_alpha_skip, -(-w // TILE), -(-h // TILE), bool(settings.antialiased)]
    numbers += [settings.by_distance]
    return np.array(numbers, dtype=np.float32)


@inlined
def unit_quats(quats, i):
    """16 quaternions (w, x, y, z) from row i on, normalised; and one over their lengths."""
    w, x, y, z = unzip4(load(quats, 4 * i), load(quats, 4 * i + 16), load(quats, 4 * i + 32), load(quats, 4 * i + 48))
    inverse = spread(_f(1.0)) / root(maximum(w * w + x * x + y * y + z * z, _f(1e-30)))
    return w * inverse, x * inverse, y * inverse, z * inverse, inverse


@inlined
def rotation(w, x, y, z):
    """Rotation matrices of unit quaternions."""
    one, two = spread(_f(1.0)), _f(2.0)
    return (
        one - (y * y + z * z) * two,
        (x * y - w * z) * two,
        (x * z + w * y) * two,
        (x * y + w * z) * two,
        one - (x * x + z * z) * two,
        (y * z - w * x) * two,
        (x * z - w * y) * two,
        (y * z + w * x) * two,
        one - (x * x + y * y) * two,
    )


@inlined
def rows3(array, i):
    """Three columns of 16 rows of a flat (N, 3) array."""
    return unzip3(load(array, 3 * i), load(array, 3 * i + 16), load(array, 3 * i + 32))


@inlined
def scale_lanes(log_scales, i):
    """The three standard deviations of 16 Gaussians from row i on."""
    s0, s1, s2 = rows3(log_scales, i)
    top = _LARGEST_EXPONENT
    return (
        exp2(maximum(minimum(s0 * _LOG2_E, top), -top)),
        exp2(maximum(minimum(s1 * _LOG2_E, top), -top)),
        exp2(maximum(minimum(s2 * _LOG2_E, top), -top)),
    )


@inlined
def affine_rows(iz, kx, ky, R, fx, fy):
    """Rows of T = J W, Jacobian of the projection times world-to-camera rotation; and J's four entries.

    kx and ky are x/z and y/z, held within the frustum's margin.
    """
    jx, jy = iz * fx, iz * fy
    jxz, jyz = -jx * kx, -jy * ky
    a = (jx * R[0] + jxz * R[6], jx * R[1] + jxz * R[7], jx * R[2] + jxz * R[8])
    b = (jy * R[3] + jyz * R[6], jy * R[4] + jyz * R[7], jy * R[5] + jyz * R[8])
    return a, b, jx, jxz, jy, jyz


@inlined
def covariance(p, q, eps2d):
    """Variances in x and y, covariance and determinant of P P^T + eps2d, from the rows of P (Eq 2).

    The determinant comes as a sum of squares (Lagrange's identity): var_x var_y - cov^2 cancels for needles.
    """
    n = cross(p, q)
    pp, qq = dot(p, p), dot(q, q)
    return pp + eps2d, qq + eps2d, dot(p, q), dot(n, n) + (pp + qq) * eps2d + eps2d * eps2d


@inlined
def log2_opacity(logits, i):
    """log2(sigmoid(logit)) of 16 Gaussians from row i on."""
    x = load(logits, i) * -_LOG2_E
    return -log2(exp2(maximum(minimum(x, _LARGEST_EXPONENT), -_LARGEST_EXPONENT)) + _f(1.0))


@inlined
def tile_of(pixels, last):
    """Tile (as float) that holds a pixel centre at or before this coordinate, clipped to the image."""
    return minimum(maximum(round_down((pixels - _f(0.5)) * _TILES_PER_PIXEL), _f(0.0)), last)


@inlined
def span_ends(dy, a, b, c, below):
    """The larger and the smaller root dx of a dx^2 + b dx dy + c dy^2 + below = 0; a < 0."""
    inside = root(maximum((b * dy) * (b * dy) - a * (c * dy * dy + below) * _f(4.0), _f(0.0)))
    middle, half = b * dy, _f(-0.5) / a
    return (middle + inside) * half, (middle - inside) * half


@inlined
def tile_cover(wanted, u, v, hx, hy, ellipse, rect):
    """Bits of `project`'s covers, as floats, of 16 ellipses with centres (u, v), half extents (hx, hy), tiles `rect`.

    ``ellipse``: a, b, c of the record, l above its threshold, slope_y. Per row of tiles the ellipse's span in x: it
    reaches its largest dx at dy = slope_y hx, and grows towards it.
    """
    a, b, c, below, slope_y = ellipse
    left, right, top, bottom = rect
    zero = spread(_f(0.0))
    columns, rows = right - left, bottom - top
    exact = (columns < _f(0.5)) | (rows < _f(0.5))  # one column or one row: all of the rectangle
    small = (columns < _f(COVER - 0.5)) & (rows < _f(COVER - 0.5))
    peak = slope_y * hx
    cover = zero
    y = _f(0.0)
    weight = _f(1.0)  # of the first bit of the row
    while y < _f(COVER) and (bits_of(small & (rows >= y)) & wanted) != 0:
        begins, ends = zero, columns
        if (bits_of(small & (rows >= y) & (rows > _f(0.5)) & (columns > _f(0.5))) & wanted) != 0:
            edge = (top + y) * _f(TILE) - v
            first, last = maximum(edge + _f(0.5), -hy), minimum(edge + _f(TILE - 0.5), hy)
            high, _ = span_ends(minimum(maximum(peak, first), last), a, b, c, below)
            _, low = span_ends(minimum(maximum(-peak, first), last), a, b, c, below)
            from_ = maximum(round_down((u + maximum(low, -hx) - _f(0.5)) * _TILES_PER_PIXEL) - left, zero)
            to = minimum(round_down((u + minimum(high, hx) - _f(0.5)) * _TILES_PER_PIXEL) - left, columns)
            to = select(first <= last, to, spread(_f(-1.0)))
            begins, ends = select(exact, begins, from_), select(exact, ends, to)
        ends = select(rows >= y, ends, spread(_f(-1.0)))
        for x in range(COVER):
            column = _f(x)
            cover += select((begins <= column) & (ends >= column), spread(weight), zero)
            weight += weight
        y += _f(1.0)
    return select(small, cover, zero)


@parallel_kernel
def project(means, quats, log_scales, logits, lens, chunk, scratch, records, bounds, depths, index, counts, call):
    """Project every Gaussian.

    Parameters
    ----------
    means, quats, log_scales, logits : flat float32, N rows, N >= 16
    lens : see `pack_lens`
    chunk : Gaussians per chunk, a multiple of 16
    scratch : (chunks, LANE_SCRATCH)
    records : flat, RECORD numbers a Gaussian, out
    bounds : (extents, rects, covers), out
        Flat: 2, 4 (int16: first and last tile column, row) numbers a Gaussian, and one (uint16): bit ``COVER y + x``
        where the ellipse reaches the tile in column x and row y of its rectangle; 0 where that is larger than COVER.
    depths, index : (N,) out
        Each chunk fills its own stretch from the front.
    counts : (chunks,) out
        How many it wrote.
    """
    extents, rects, covers = bounds
    n = logits.shape[0]
    R = (lens[0], lens[1], lens[2], lens[3], lens[4], lens[5], lens[6], lens[7], lens[8])
    t = (lens[9], lens[10], lens[11])
    fx, fy, cx, cy = lens[12], lens[13], lens[14], lens[15]
    right, left, bottom, top = lens[16], lens[17], lens[18], lens[19]
    width, height, eps2d, near, log2_skip = lens[20], lens[21], lens[22], lens[23], lens[24]
    last_column, last_row = lens[25] - _f(1.0), lens[26] - _f(1.0)
    antialiased, by_distance = lens[27] != _f(0.0), lens[28] != _f(0.0)
    for part in share_of(counts.shape[0], call):
        own = scratch[part]
        begin = part * chunk
        end = min(n, begin + chunk)
        filled = begin
        for first in range(begin, end, 16):
            i = min(first, n - 16)  # the last group overlaps the one before; its lanes below `first` are masked
            wanted = (_i(0xFFFF) << _i(first - i)) & _i(0xFFFF)
            mean = rows3(means, i)
            z = dot(R[6:9], mean) + t[2]
            l = log2_opacity(logits, i)
            wanted &= bits_of((z > near) & (l >= log2_skip))
            if wanted == 0:
                continue
            iz = _f(1.0) / z
            xz, yz = (dot(R[0:3], mean) + t[0]) * iz, (dot(R[3:6], mean) + t[1]) * iz
            u, v = xz * fx + cx, yz * fy + cy
            kx, ky = minimum(maximum(xz, left), right), minimum(maximum(yz, top), bottom)
            a, b, _, _, _, _ = affine_rows(iz, kx, ky, R, fx, fy)
            qw, qx, qy, qz, _ = unit_quats(quats, i)
            M = scale_columns(rotation(qw, qx, qy, qz), scale_lanes(log_scales, i))
            var_x, var_y, cov, det = covariance(row_times(a, M), row_times(b, M), eps2d)
            if antialiased:
                sharp = det - (var_x + var_y - eps2d) * eps2d  # the determinant without the low pass
                l += log2(maximum(sharp / det, _f(_LEAST_SHARPNESS))) * _f(0.5)
            reach = (l - log2_skip) * _f(2.0 * math.log(2.0))  # alpha >= skip where the Mahalanobis^2 <= reach
            hx, hy = root(reach * var_x), root(reach * var_y)
            wanted &= bits_of(
                (reach >= _f(0.0))
                & (var_x <= _MAX_VARIANCE)
                & (var_y <= _MAX_VARIANCE)
                & (det > _f(1e-12))
                & (u + hx >= _f(0.5))
                & (u - hx <= width - _f(0.5))
                & (v + hy >= _f(0.5))
                & (v - hy <= height - _f(0.5))
            )
            if wanted == 0:
                continue
            k = _f(-0.5 * math.log2(math.e)) / det
            store(own, 0, u)
            store(own, 16, v)
            ellipse = (k * var_y, k * cov * _f(-2.0), k * var_x, l - log2_skip, cov / var_x)
            store(own, 32, ellipse[0])
            store(own, 48, ellipse[1])
            store(own, 64, ellipse[2])
            store(own, 80, l)
            store(own, 96, cov / var_y)
            store(own, 112, ellipse[4])
            store(own, 128, hx)
            store(own, 144, hy)
            rect = (
                tile_of(u - hx, last_column),
                tile_of(u + hx, last_column),
                tile_of(v - hy, last_row),
                tile_of(v + hy, last_row),
            )
            for side in range(4):
                store(own, 160 + 16 * side, rect[side])
            store(own, 240, tile_cover(wanted, u, v, hx, hy, ellipse, rect))
            store(own, 224, z)
            if by_distance:
                store(own, 224, z * root(xz * xz + yz * yz + _f(1.0)))
            while wanted != 0:
                lane = lowest_bit(wanted)
                wanted &= wanted - _i(1)
                j = i + np.int64(lane)
                for field in range(RECORD):
                    records[j * RECORD + field] = own[field * 16 + lane]
                extents[2 * j] = own[128 + lane]
                extents[2 * j + 1] = own[144 + lane]
                for side in range(4):
                    rects[4 * j + side] = np.int16(own[160 + side * 16 + lane])
                covers[j] = np.uint16(own[240 + lane])
                depths[filled] = own[224 + lane]
                index[filled] = j
                filled += 1
        counts[part] = filled - begin
