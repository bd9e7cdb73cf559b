"""From the sums of a Gaussian to the gradients of its parameters and of the camera, sixteen at a time.

The chain of `projection.project` and of `sh_kernels.evaluate_sh` backwards: every pair is read once. Gaussians
come in chunks of fixed size; each leaves its own sums for the camera, added up in order, so the camera's gradient too
has the same bits on any number of threads.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.raster.lane_math import add, dot, exp2, row_times, scale_columns, times
from engine.raster.lane_memory import load, prefetch, store, sum_rows, transpose
from engine.raster.lane_order import zip3, zip4
from engine.raster.lanes import constant_lanes, maximum, minimum, select, spread
from engine.raster.moments import PAIR_NUMBERS
from engine.raster.projection import affine_rows, covariance, log2_opacity, rotation, rows3, scale_lanes, unit_quats
from engine.raster.sh_kernels import differentiate_group

CHUNK = 4096
"""Gaussians per chunk; never depends on the number of threads."""


def chunks_of(n: int) -> int:
    """Chunks of n >= 16 Gaussians: the last has up to 15 more, so that no group reaches into another thread's."""
    return (n - 16) // CHUNK + 1


GRADIENT_SCRATCH = 3 * 256 + 32 * 16
"""Floats of scratch a chunk needs."""

_f = np.float32
_AHEAD = 24  # pairs: about the time that a line takes from memory
_TURNED, _SEEN, _SUMS = 256, 512, 768
_SIXTEEN = (0,) * 16
_lane_number = constant_lanes([float(lane) for lane in range(16)])


@inlined
def gather_pairs(own, values, firsts, slots, first):
    """Row k at own[_TURNED] becomes quantity k of 16 Gaussians; own[_SEEN] tells which of them have pairs."""
    total = np.int64(firsts[firsts.shape[0] - 1])
    for g in range(16):
        sums = spread(_f(0.0))
        begin, end = np.int64(firsts[first + g]), np.int64(firsts[first + g + 1])
        for s in range(begin, end):
            if s + _AHEAD < total:
                prefetch(values, np.int64(slots[s + _AHEAD]) * PAIR_NUMBERS)
            sums += load(values, np.int64(slots[s]) * PAIR_NUMBERS)
        store(own, g * 16, sums)
        own[_SEEN + g] = _f(1.0) if end > begin else _f(0.0)
    transpose(own, 0, _TURNED)


@inlined
def add_to(own, row, value, counted):
    """Add to one of the chunk's sums, where the lane counts."""
    store(own, _SUMS + row * 16, load(own, _SUMS + row * 16) + select(counted, value, spread(_f(0.0))))


@inlined
def write_rows3(array, i, seen, x, y, z):
    """Three columns of 16 rows to a flat (N, 3) array, 0 where not seen."""
    zero = spread(_f(0.0))
    a, b, c = zip3(select(seen, x, zero), select(seen, y, zero), select(seen, z, zero))
    store(array, 3 * i, a)
    store(array, 3 * i + 16, b)
    store(array, 3 * i + 32, c)


@inlined
def write_quats(array, i, seen, unit, inverse, gradient):
    """Gradient with respect to quaternions of any length, from that with respect to their unit ones."""
    along = gradient[0] * unit[0] + gradient[1] * unit[1] + gradient[2] * unit[2] + gradient[3] * unit[3]
    zero = spread(_f(0.0))
    w, x, y, z = zip4(
        select(seen, (gradient[0] - along * unit[0]) * inverse, zero),
        select(seen, (gradient[1] - along * unit[1]) * inverse, zero),
        select(seen, (gradient[2] - along * unit[2]) * inverse, zero),
        select(seen, (gradient[3] - along * unit[3]) * inverse, zero),
    )
    store(array, 4 * i, w)
    store(array, 4 * i + 16, x)
    store(array, 4 * i + 32, y)
    store(array, 4 * i + 48, z)


@inlined
def to_unit_quat(d, w, x, y, z):
    """Gradient with respect to a unit quaternion from that with respect to its matrix (d, 9 entries)."""
    two = _f(2.0)
    return (
        (x * (d[7] - d[5]) + y * (d[2] - d[6]) + z * (d[3] - d[1])) * two,
        (y * (d[1] + d[3]) + z * (d[2] + d[6]) + w * (d[7] - d[5]) - x * (d[4] + d[8]) * two) * two,
        (x * (d[1] + d[3]) + z * (d[5] + d[7]) + w * (d[2] - d[6]) - y * (d[0] + d[8]) * two) * two,
        (x * (d[2] + d[6]) + y * (d[5] + d[7]) + w * (d[3] - d[1]) - z * (d[0] + d[4]) * two) * two,
    )


@inlined
def outer_sum(a, p, b, q):
    """a p^T + b q^T, row by row."""
    return (
        a[0] * p[0] + b[0] * q[0],
        a[0] * p[1] + b[0] * q[1],
        a[0] * p[2] + b[0] * q[2],
        a[1] * p[0] + b[1] * q[0],
        a[1] * p[1] + b[1] * q[1],
        a[1] * p[2] + b[1] * q[2],
        a[2] * p[0] + b[2] * q[0],
        a[2] * p[1] + b[2] * q[1],
        a[2] * p[2] + b[2] * q[2],
    )


@inlined
def weighted_rows(x, p, y, q):
    """2 (x p + y q)"""
    two = _f(2.0)
    return ((x * p[0] + y * q[0]) * two, (x * p[1] + y * q[1]) * two, (x * p[2] + y * q[2]) * two)


@inlined
def add_row(own, row, g, mean, j0, t0, j1, t1, counted):
    """Three sums of the camera's rotation: g mean + j0 t0 + j1 t1."""
    for k in range(3):
        add_to(own, row + k, g * mean[k] + j0 * t0[k] + j1 * t1[k], counted)


@inlined
def differentiate_colors(own, sh_scratch, shading, means, first, end, d_means, d_colors, d_sh):
    """From dL/dcolors of 16 Gaussians from `first` on to dL/dSH, and on to their centres and the camera's."""
    sh, coefficients, colors, position = shading
    i = min(first, end - 16)  # rows below `first` have been counted
    zero, counted = spread(_f(0.0)), _lane_number() >= _f(first - i)
    shown, by_color = rows3(colors, i), rows3(d_colors, i)
    pulls = (
        select(shown[0] > zero, by_color[0], zero),
        select(shown[1] > zero, by_color[1], zero),
        select(shown[2] > zero, by_color[2], zero),
    )
    x, y, z = differentiate_group(sh_scratch, sh, coefficients, i, 16, end, rows3(means, i), position, pulls, d_sh)
    toward = (select(counted, x, zero), select(counted, y, zero), select(counted, z, zero))
    world = zip3(*add(rows3(d_means, i), toward))
    for part in range(3):
        store(d_means, 3 * i + 16 * part, world[part])
        add_to(own, 16 + part, -toward[part], counted)


@parallel_kernel
def parameter_gradients(raw, lens, values, firsts, slots, shading, scratches, out, call):
    """Gradients of N >= 16 Gaussians and of the camera.

    Parameters
    ----------
    raw : means, quats, log_scales, logits; they and `lens` as for `projection.project`
    values : flat (pairs, PAIR_NUMBERS), from `moments.pair_moments`
    firsts, slots : see `geometry.Geometry`
    shading : SH (flat, empty if colours were given), coefficients, colours (flat), the camera's position
    scratches : (chunks, GRADIENT_SCRATCH) and (chunks, SH_SCRATCH)
    out : gradients of raw, as flat; of the projected centres, pixels, flat (2, N); of colours and SH, flat; and
        (chunks, 32), of which 19 are the camera's sums: rotation (9) and translation (3) in its frame; fx, fy, cx, cy;
        its position by way of the colours (3)
    """
    means, quats, log_scales, logits = raw
    d_means, d_quats, d_log_scales, d_logits, d_centers, d_colors, d_sh, d_camera = out
    sh, _, _, _ = shading
    scratch, sh_scratch = scratches
    n = logits.shape[0]
    R = (lens[0], lens[1], lens[2], lens[3], lens[4], lens[5], lens[6], lens[7], lens[8])
    t = (lens[9], lens[10], lens[11])
    fx, fy = lens[12], lens[13]
    right, left, bottom, top = lens[16], lens[17], lens[18], lens[19]
    eps2d = lens[22]
    for part in share_of(scratch.shape[0], call):
        own = scratch[part]
        zero, one, two, minus_half = spread(_f(0.0)), spread(_f(1.0)), _f(2.0), _f(-0.5)
        for row in range(32):
            store(own, _SUMS + row * 16, zero)
        end = n if part == scratch.shape[0] - 1 else (part + 1) * CHUNK
        for first in range(part * CHUNK, end, 16):
            i = min(first, end - 16)  # the last group overlaps the one before, which has already been counted
            gather_pairs(own, values, firsts, slots, i)
            seen = load(own, _SEEN) > _f(0.5)
            counted = seen & (_lane_number() >= _f(first - i))

            # 1. Projection again: P = T M, covariance P P^T, conic its inverse
            mean = rows3(means, i)
            iz = one / select(seen, dot(R[6:9], mean) + t[2], one)
            xz, yz = (dot(R[0:3], mean) + t[0]) * iz, (dot(R[3:6], mean) + t[1]) * iz
            kx, ky = minimum(maximum(xz, left), right), minimum(maximum(yz, top), bottom)
            a, b, jx, jxz, jy, jyz = affine_rows(iz, kx, ky, R, fx, fy)
            qw, qx, qy, qz, inverse = unit_quats(quats, i)
            scales = scale_lanes(log_scales, i)
            M = scale_columns(rotation(qw, qx, qy, qz), scales)
            p, q = row_times(a, M), row_times(b, M)
            var_x, var_y, cov, det = covariance(p, q, eps2d)
            ca, cb, cc = var_y / det, -cov / det, var_x / det

            # 2. Moments to projected centre and covariance:
            #    ln alpha = ln o - (ca dx^2 + 2 cb dx dy + cc dy^2) / 2
            g0, g1, g2 = load(own, _TURNED), load(own, _TURNED + 16), load(own, _TURNED + 32)
            ga = load(own, _TURNED + 48) * minus_half
            gb = load(own, _TURNED + 64) * minus_half
            gc = load(own, _TURNED + 80) * minus_half
            du, dv = ca * g1 + cb * g2, cb * g1 + cc * g2
            store(d_centers, i, select(seen, du, zero))
            store(d_centers, n + i, select(seen, dv, zero))
            h00, h01, h10, h11 = ca * ga + cb * gb, ca * gb + cb * gc, cb * ga + cc * gb, cb * gb + cc * gc
            e00, e01, e11 = -(h00 * ca + h01 * cb), -(h00 * cb + h01 * cc), -(h10 * cb + h11 * cc)

            by_color = (load(own, _TURNED + 96), load(own, _TURNED + 112), load(own, _TURNED + 128))
            write_rows3(d_colors, i, seen, by_color[0], by_color[1], by_color[2])

            # 3. To P, and through it to M = R S and T = J W
            dp, dq = weighted_rows(e00, p, e01, q), weighted_rows(e01, p, e11, q)
            dM = outer_sum(a, dp, b, dq)
            ta, tb = times(M, dp), times(M, dq)

            # 4. Scales and rotation
            write_rows3(
                d_log_scales,
                i,
                seen,
                dM[0] * M[0] + dM[3] * M[3] + dM[6] * M[6],
                dM[1] * M[1] + dM[4] * M[4] + dM[7] * M[7],
                dM[2] * M[2] + dM[5] * M[5] + dM[8] * M[8],
            )
            dR = scale_columns(dM, scales)
            write_quats(d_quats, i, seen, (qw, qx, qy, qz), inverse, to_unit_quat(dR, qw, qx, qy, qz))

            # 5. The centre in the camera frame, by way of the projected centre and of J
            djx, djxz, djy, djyz = dot(R[0:3], ta), dot(R[6:9], ta), dot(R[3:6], tb), dot(R[6:9], tb)
            free_x, free_y = (xz >= left) & (xz <= right), (yz >= top) & (yz <= bottom)
            gx = jx * (du - iz * select(free_x, djxz, zero))
            gy = jy * (dv - iz * select(free_y, djyz, zero))
            gz = jx * (iz * (djxz * select(free_x, xz * two, kx) - djx) - du * xz) + jy * (
                iz * (djyz * select(free_y, yz * two, ky) - djy) - dv * yz
            )

            # 6. The centre in the world, opacity, and what moves the camera
            world = row_times((gx, gy, gz), R)
            write_rows3(d_means, i, seen, world[0], world[1], world[2])
            store(d_logits, i, select(seen, g0 * (one - exp2(log2_opacity(logits, i))), zero))
            add_row(own, 0, gx, mean, jx, ta, zero, tb, counted)
            add_row(own, 3, gy, mean, zero, ta, jy, tb, counted)
            add_row(own, 6, gz, mean, jxz, ta, jyz, tb, counted)
            add_to(own, 9, gx, counted)
            add_to(own, 10, gy, counted)
            add_to(own, 11, gz, counted)
            add_to(own, 12, du * xz + iz * (djx - select(free_x, xz * djxz, zero)), counted)
            add_to(own, 13, dv * yz + iz * (djy - select(free_y, yz * djyz, zero)), counted)
            add_to(own, 14, du + select(free_x, zero, iz * djxz), counted)
            add_to(own, 15, dv + select(free_y, zero, iz * djyz), counted)
        # 7. Colours to SH, apart from the rest: fewer streams of memory at a time.
        if sh.shape[0] > 0:
            for first in range(part * CHUNK, end, 16):
                differentiate_colors(own, sh_scratch[part], shading, means, first, end, d_means, d_colors, d_sh)
        store(d_camera[part], 0, sum_rows(own, _SUMS, _SIXTEEN))
        store(d_camera[part], 16, sum_rows(own, _SUMS + 256, _SIXTEEN))
