"""Pass 1: Gaussians to the image plane, sixteen at a time.

Writes one record of `RECORD` floats per visible Gaussian, at the Gaussian's own index (so no pass needs a map):

    u, v               centre, pixels
    a, b, c, l         alpha = 2^q with q = a dx^2 + b dx dy + c dy^2 + l (a, c < 0; l = log2 of the opacity)
    slope_x, slope_y   on a line of constant dy, q peaks at dx = slope_x dy; of constant dx, at dy = slope_y dx

and, for the later passes, the half extents of {alpha >= alpha_skip}, the rectangle of tiles they touch, and a
compact list (depth, index) per chunk. The extent follows from opacity and threshold exactly, so tight lists
change no pixel.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
from __future__ import annotations

import math

import numpy as np
from numba import prange

from engine.model import Camera, Float32
from engine.numerics.jit import inlined, parallel_kernel
from engine.raster.lane_math import exp2, log2
from engine.raster.lane_memory import load, lowest_bit, store, unzip3, unzip4
from engine.raster.lanes import bits_of, maximum, minimum, root, round_down, spread
from engine.raster.settings import FRUSTUM_MARGIN, MAX_SIGMA_PX, TILE, RasterSettings

__all__ = ["LANE_SCRATCH", "RECORD", "pack_lens", "project"]

_KERNEL_VERSION = 1

RECORD = 8
"""Floats per record."""

LANE_SCRATCH = 16 * 16
"""Floats of scratch a chunk needs."""

_f = np.float32
_i = np.int32
_LOG2_E = _f(math.log2(math.e))
_MAX_VARIANCE = _f(MAX_SIGMA_PX**2)
_TILES_PER_PIXEL = _f(1.0 / TILE)
_LARGEST_EXPONENT = _f(126.0)


def pack_lens(camera: Camera, settings: RasterSettings) -> Float32:
    """Camera and settings as the flat float32 array that the kernels unpack.

    Rotation (9), translation (3), fx, fy, cx, cy, the four limits of x/z and y/z for the Jacobian
    (right, left, bottom, top), width, height, eps2d, near, log2 of the smallest alpha, tiles per row and column.
    """
    R, t, K = camera.viewmat[:3, :3], camera.viewmat[:3, 3], camera.K
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    w, h = camera.width, camera.height
    margin_x, margin_y = FRUSTUM_MARGIN * 0.5 * w / fx, FRUSTUM_MARGIN * 0.5 * h / fy
    limits = [(w - cx) / fx + margin_x, -cx / fx - margin_x, (h - cy) / fy + margin_y, -cy / fy - margin_y]
    numbers = [*R.ravel(), *t, fx, fy, cx, cy, *limits, w, h, settings.eps2d, settings.near]
    numbers += [settings.log2_alpha_skip, -(-w // TILE), -(-h // TILE)]
    return np.array(numbers, dtype=np.float32)


@inlined
def rotation_rows(quats, i):
    """Rotation matrices, row by row, of the 16 quaternions (w, x, y, z) from row i on; normalises them."""
    w, x, y, z = unzip4(
        load(quats, 4 * i), load(quats, 4 * i + 16), load(quats, 4 * i + 32), load(quats, 4 * i + 48)
    )
    s = _f(2.0) / maximum(w * w + x * x + y * y + z * z, _f(1e-30))  # 2 / |q|^2
    one = spread(_f(1.0))
    return (
        one - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y),
        s * (x * y + w * z), one - s * (x * x + z * z), s * (y * z - w * x),
        s * (x * z - w * y), s * (y * z + w * x), one - s * (x * x + y * y),
    )  # fmt: skip


@inlined
def scale_lanes(log_scales, i):
    """The three standard deviations of 16 Gaussians from row i on."""
    s0, s1, s2 = unzip3(load(log_scales, 3 * i), load(log_scales, 3 * i + 16), load(log_scales, 3 * i + 32))
    top = _LARGEST_EXPONENT
    return (
        exp2(maximum(minimum(s0 * _LOG2_E, top), -top)),
        exp2(maximum(minimum(s1 * _LOG2_E, top), -top)),
        exp2(maximum(minimum(s2 * _LOG2_E, top), -top)),
    )


@inlined
def log2_opacity(logits, i):
    """log2(sigmoid(logit)) of 16 Gaussians from row i on."""
    x = load(logits, i) * -_LOG2_E
    return -log2(exp2(maximum(minimum(x, _LARGEST_EXPONENT), -_LARGEST_EXPONENT)) + _f(1.0))


@inlined
def tile_of(pixels, last):
    """Tile (as float) that holds a pixel centre at or before this coordinate, clipped to the image."""
    return minimum(maximum(round_down((pixels - _f(0.5)) * _TILES_PER_PIXEL), _f(0.0)), last)


@parallel_kernel
def project(
    means, quats, log_scales, logits, lens, chunk, scratch, records, extents, rects, depths, index, counts
):
    """Project every Gaussian.

    Parameters
    ----------
    means, quats, log_scales, logits : flat float32, N rows, N >= 16
    lens : see `pack_lens`
    chunk : Gaussians per chunk, a multiple of 16
    scratch : (chunks, LANE_SCRATCH)
    records, extents, rects : flat, RECORD, 2 and 4 (int16: first and last tile column, row) numbers a Gaussian
    depths, index : (N,) out; each chunk fills its own stretch from the front
    counts : (chunks,) out, how many it wrote
    """
    n = logits.shape[0]
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = lens[0], lens[1], lens[2], lens[3], lens[4], lens[5], lens[6], lens[7], lens[8]  # fmt: skip
    t0, t1, t2, fx, fy, cx, cy = lens[9], lens[10], lens[11], lens[12], lens[13], lens[14], lens[15]
    right, left, bottom, top = lens[16], lens[17], lens[18], lens[19]
    width, height, eps2d, near, log2_skip = lens[20], lens[21], lens[22], lens[23], lens[24]
    last_column, last_row = lens[25] - _f(1.0), lens[26] - _f(1.0)
    for part in prange(counts.shape[0]):
        own = scratch[part]
        begin = part * chunk
        end = min(n, begin + chunk)
        filled = begin
        for first in range(begin, end, 16):
            i = min(
                first, n - 16
            )  # the last group overlaps the one before; its lanes below `first` are masked
            wanted = (_i(0xFFFF) << _i(first - i)) & _i(0xFFFF)
            mx, my, mz = unzip3(load(means, 3 * i), load(means, 3 * i + 16), load(means, 3 * i + 32))
            z = mx * r20 + my * r21 + mz * r22 + t2
            l = log2_opacity(logits, i)
            wanted &= bits_of((z > near) & (l >= log2_skip))
            if wanted == 0:
                continue
            x = mx * r00 + my * r01 + mz * r02 + t0
            y = mx * r10 + my * r11 + mz * r12 + t1
            iz = _f(1.0) / z
            xz, yz = x * iz, y * iz
            u, v = xz * fx + cx, yz * fy + cy
            # (2 x 3) T = J W: Jacobian of the projection times world-to-camera rotation
            jx, jy = iz * fx, iz * fy
            jxz, jyz = -jx * minimum(maximum(xz, left), right), -jy * minimum(maximum(yz, top), bottom)
            a0, a1, a2 = jx * r00 + jxz * r20, jx * r01 + jxz * r21, jx * r02 + jxz * r22
            b0, b1, b2 = jy * r10 + jyz * r20, jy * r11 + jyz * r21, jy * r12 + jyz * r22
            # (2 x 3) P = T R S, so that P P^T is the projected covariance (Eq 2)
            m00, m01, m02, m10, m11, m12, m20, m21, m22 = rotation_rows(quats, i)
            s0, s1, s2 = scale_lanes(log_scales, i)
            p0, p1, p2 = (a0 * m00 + a1 * m10 + a2 * m20) * s0, (a0 * m01 + a1 * m11 + a2 * m21) * s1, (a0 * m02 + a1 * m12 + a2 * m22) * s2  # fmt: skip
            q0, q1, q2 = (b0 * m00 + b1 * m10 + b2 * m20) * s0, (b0 * m01 + b1 * m11 + b2 * m21) * s1, (b0 * m02 + b1 * m12 + b2 * m22) * s2  # fmt: skip
            pp, qq = p0 * p0 + p1 * p1 + p2 * p2, q0 * q0 + q1 * q1 + q2 * q2
            var_x, cov, var_y = pp + eps2d, p0 * q0 + p1 * q1 + p2 * q2, qq + eps2d
            # Determinant as a sum of squares (Lagrange): var_x var_y - cov^2 cancels for needles.
            n0, n1, n2 = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
            det = n0 * n0 + n1 * n1 + n2 * n2 + eps2d * (pp + qq) + eps2d * eps2d
            reach = (l - log2_skip) * _f(
                2.0 * math.log(2.0)
            )  # alpha >= skip where the Mahalanobis^2 <= reach
            hx, hy = root(reach * var_x), root(reach * var_y)
            wanted &= bits_of(
                (var_x <= _MAX_VARIANCE) & (var_y <= _MAX_VARIANCE) & (det > _f(1e-12))
                & (u + hx >= _f(0.5)) & (u - hx <= width - _f(0.5))
                & (v + hy >= _f(0.5)) & (v - hy <= height - _f(0.5))
            )  # fmt: skip
            if wanted == 0:
                continue
            k = _f(-0.5 * math.log2(math.e)) / det
            store(own, 0, u)
            store(own, 16, v)
            store(own, 32, k * var_y)
            store(own, 48, k * cov * _f(-2.0))
            store(own, 64, k * var_x)
            store(own, 80, l)
            store(own, 96, cov / var_y)
            store(own, 112, cov / var_x)
            store(own, 128, hx)
            store(own, 144, hy)
            store(own, 160, tile_of(u - hx, last_column))
            store(own, 176, tile_of(u + hx, last_column))
            store(own, 192, tile_of(v - hy, last_row))
            store(own, 208, tile_of(v + hy, last_row))
            store(own, 224, z)
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
                depths[filled] = own[224 + lane]
                index[filled] = j
                filled += 1
        counts[part] = filled - begin
