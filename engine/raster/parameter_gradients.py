"""From the moments of a Gaussian to the gradients of its parameters and of the camera, sixteen at a time.

The chain of `projection.project` backwards. Gaussians come in chunks of fixed size; each leaves its own sums for the
camera, added up in order, so the camera's gradient too has the same bits on any number of threads.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
from __future__ import annotations

import numpy as np
from numba import prange

from engine.numerics.jit import inlined, parallel_kernel
from engine.raster.lane_math import exp2
from engine.raster.lane_memory import load, prefetch, store, sum_rows, transpose, unzip3, unzip4, zip3, zip4
from engine.raster.lanes import constant_lanes, maximum, minimum, root, select, spread
from engine.raster.moments import PAIR_NUMBERS
from engine.raster.projection import log2_opacity, rotation_rows, scale_lanes

__all__ = ["CAMERA_SUMS", "CHUNK", "GRADIENT_SCRATCH", "parameter_gradients"]

_KERNEL_VERSION = 1

CHUNK = 4096
"""Gaussians per chunk; never depends on the number of threads."""

CAMERA_SUMS = 19
"""Rotation (9) and translation (3) in the camera frame; fx, fy, cx, cy; dL/d(camera position) by the colours (3)."""

GRADIENT_SCRATCH = 3 * 256 + 32 * 16
"""Floats of scratch a chunk needs."""

_f = np.float32
_i = np.int32
_AHEAD = 24
_TURNED, _SEEN, _SUMS = 256, 512, 768
_SIXTEEN = (0,) * 16
_lane_number = constant_lanes([float(lane) for lane in range(16)])


@inlined
def gather_moments(own, values, firsts, slots, first):
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
def rows3(array, i):
    """Three columns of 16 rows of a flat (N, 3) array."""
    return unzip3(load(array, 3 * i), load(array, 3 * i + 16), load(array, 3 * i + 32))


@inlined
def write_rows3(array, i, seen, x, y, z):
    """Three columns of 16 rows to a flat (N, 3) array, 0 where not seen."""
    zero = spread(_f(0.0))
    a, b, c = zip3(select(seen, x, zero), select(seen, y, zero), select(seen, z, zero))
    store(array, 3 * i, a)
    store(array, 3 * i + 16, b)
    store(array, 3 * i + 32, c)


@inlined
def write_quats(array, quats, i, seen, w, x, y, z):
    """Gradient with respect to quaternions of any length from that with respect to their unit ones."""
    qw, qx, qy, qz = unzip4(
        load(quats, 4 * i), load(quats, 4 * i + 16), load(quats, 4 * i + 32), load(quats, 4 * i + 48)
    )
    scale = spread(_f(1.0)) / root(maximum(qw * qw + qx * qx + qy * qy + qz * qz, _f(1e-30)))
    qw, qx, qy, qz = qw * scale, qx * scale, qy * scale, qz * scale
    along = w * qw + x * qx + y * qy + z * qz
    zero = spread(_f(0.0))
    a, b, c, d = zip4(
        select(seen, (w - along * qw) * scale, zero), select(seen, (x - along * qx) * scale, zero),
        select(seen, (y - along * qy) * scale, zero), select(seen, (z - along * qz) * scale, zero),
    )  # fmt: skip
    store(array, 4 * i, a)
    store(array, 4 * i + 16, b)
    store(array, 4 * i + 32, c)
    store(array, 4 * i + 48, d)


@inlined
def unit_quats(quats, i):
    """16 quaternions from row i on, normalised."""
    w, x, y, z = unzip4(
        load(quats, 4 * i), load(quats, 4 * i + 16), load(quats, 4 * i + 32), load(quats, 4 * i + 48)
    )
    scale = spread(_f(1.0)) / root(maximum(w * w + x * x + y * y + z * z, _f(1e-30)))
    return w * scale, x * scale, y * scale, z * scale


@parallel_kernel
def parameter_gradients(
    means, quats, log_scales, logits, lens, values, firsts, slots, toward, scratch,
    d_means, d_quats, d_log_scales, d_logits, d_camera,
):  # fmt: skip
    """Gradients of N >= 16 Gaussians and of the camera.

    Parameters
    ----------
    means, quats, log_scales, logits, lens : as for `projection.project`
    values : flat (pairs, PAIR_NUMBERS), from `moments.pair_moments`
    firsts, slots : see `geometry.Geometry`
    toward : flat (N, 3), dL/dmeans by way of the colours' viewing direction, or empty
    scratch : (chunks, GRADIENT_SCRATCH)
    d_means, d_quats, d_log_scales, d_logits : flat, out
    d_camera : (chunks, 32) out, `CAMERA_SUMS` numbers a chunk
    """
    n = logits.shape[0]
    r00, r01, r02 = lens[0], lens[1], lens[2]
    r10, r11, r12 = lens[3], lens[4], lens[5]
    r20, r21, r22 = lens[6], lens[7], lens[8]
    t0, t1, t2, fx, fy = lens[9], lens[10], lens[11], lens[12], lens[13]
    right, left, bottom, top = lens[16], lens[17], lens[18], lens[19]
    eps2d = lens[22]
    for part in prange(scratch.shape[0]):
        own = scratch[part]
        zero, one, two = spread(_f(0.0)), spread(_f(1.0)), _f(2.0)
        for row in range(32):
            store(own, _SUMS + row * 16, zero)
        for first in range(part * CHUNK, min(n, (part + 1) * CHUNK), 16):
            i = min(first, n - 16)  # the last group overlaps the one before, which has already been counted
            gather_moments(own, values, firsts, slots, i)
            seen = load(own, _SEEN) > _f(0.5)
            counted = seen & (_lane_number() >= _f(first - i))

            # 1. Projection again
            mx, my, mz = rows3(means, i)
            z = select(seen, mx * r20 + my * r21 + mz * r22 + t2, one)
            iz = one / z
            xz, yz = (mx * r00 + my * r01 + mz * r02 + t0) * iz, (mx * r10 + my * r11 + mz * r12 + t1) * iz
            kx, ky = minimum(maximum(xz, left), right), minimum(maximum(yz, top), bottom)
            jx, jy = iz * fx, iz * fy
            jxz, jyz = -jx * kx, -jy * ky
            a0, a1, a2 = jx * r00 + jxz * r20, jx * r01 + jxz * r21, jx * r02 + jxz * r22
            b0, b1, b2 = jy * r10 + jyz * r20, jy * r11 + jyz * r21, jy * r12 + jyz * r22
            m00, m01, m02, m10, m11, m12, m20, m21, m22 = rotation_rows(quats, i)
            s0, s1, s2 = scale_lanes(log_scales, i)
            m00, m10, m20 = m00 * s0, m10 * s0, m20 * s0  # M = R S
            m01, m11, m21 = m01 * s1, m11 * s1, m21 * s1
            m02, m12, m22 = m02 * s2, m12 * s2, m22 * s2
            p0, p1, p2 = a0 * m00 + a1 * m10 + a2 * m20, a0 * m01 + a1 * m11 + a2 * m21, a0 * m02 + a1 * m12 + a2 * m22  # fmt: skip
            q0, q1, q2 = b0 * m00 + b1 * m10 + b2 * m20, b0 * m01 + b1 * m11 + b2 * m21, b0 * m02 + b1 * m12 + b2 * m22  # fmt: skip
            pp, qq, cov = (
                p0 * p0 + p1 * p1 + p2 * p2,
                q0 * q0 + q1 * q1 + q2 * q2,
                p0 * q0 + p1 * q1 + p2 * q2,
            )
            n0, n1, n2 = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
            inverse = one / (n0 * n0 + n1 * n1 + n2 * n2 + eps2d * (pp + qq) + eps2d * eps2d)
            ca, cb, cc = (qq + eps2d) * inverse, -cov * inverse, (pp + eps2d) * inverse  # conic

            # 2. Moments to the projected centre and covariance; ln alpha = ln o - (ca dx^2 + 2 cb dx dy + cc dy^2)/2
            moment = _TURNED
            g0, g1, g2 = load(own, moment), load(own, moment + 16), load(own, moment + 32)
            ga, gb, gc = load(own, moment + 48) * _f(-0.5), load(own, moment + 64) * _f(-0.5), load(own, moment + 80) * _f(-0.5)  # fmt: skip
            du, dv = ca * g1 + cb * g2, cb * g1 + cc * g2
            h00, h01, h10, h11 = ca * ga + cb * gb, ca * gb + cb * gc, cb * ga + cc * gb, cb * gb + cc * gc
            e00, e01, e11 = -(h00 * ca + h01 * cb), -(h00 * cb + h01 * cc), -(h10 * cb + h11 * cc)

            # 3. To P = T M, with covariance P P^T
            dp0, dp1, dp2 = (
                two * (e00 * p0 + e01 * q0),
                two * (e00 * p1 + e01 * q1),
                two * (e00 * p2 + e01 * q2),
            )
            dq0, dq1, dq2 = (
                two * (e01 * p0 + e11 * q0),
                two * (e01 * p1 + e11 * q1),
                two * (e01 * p2 + e11 * q2),
            )

            # 4. To M = R S, then scales and rotation
            d00, d01, d02 = a0 * dp0 + b0 * dq0, a0 * dp1 + b0 * dq1, a0 * dp2 + b0 * dq2
            d10, d11, d12 = a1 * dp0 + b1 * dq0, a1 * dp1 + b1 * dq1, a1 * dp2 + b1 * dq2
            d20, d21, d22 = a2 * dp0 + b2 * dq0, a2 * dp1 + b2 * dq1, a2 * dp2 + b2 * dq2
            write_rows3(
                d_log_scales, i, seen, d00 * m00 + d10 * m10 + d20 * m20, d01 * m01 + d11 * m11 + d21 * m21,
                d02 * m02 + d12 * m12 + d22 * m22,
            )  # fmt: skip
            d00, d10, d20 = d00 * s0, d10 * s0, d20 * s0
            d01, d11, d21 = d01 * s1, d11 * s1, d21 * s1
            d02, d12, d22 = d02 * s2, d12 * s2, d22 * s2
            qw, qx, qy, qz = unit_quats(quats, i)
            write_quats(
                d_quats, quats, i, seen,
                two * (qx * (d21 - d12) + qy * (d02 - d20) + qz * (d10 - d01)),
                two * (qy * (d01 + d10) + qz * (d02 + d20) + qw * (d21 - d12) - two * qx * (d11 + d22)),
                two * (qx * (d01 + d10) + qz * (d12 + d21) + qw * (d02 - d20) - two * qy * (d00 + d22)),
                two * (qx * (d02 + d20) + qy * (d12 + d21) + qw * (d10 - d01) - two * qz * (d00 + d11)),
            )  # fmt: skip

            # 5. To T = J W and the centre in the camera frame
            ta0, ta1, ta2 = dp0 * m00 + dp1 * m01 + dp2 * m02, dp0 * m10 + dp1 * m11 + dp2 * m12, dp0 * m20 + dp1 * m21 + dp2 * m22  # fmt: skip
            tb0, tb1, tb2 = dq0 * m00 + dq1 * m01 + dq2 * m02, dq0 * m10 + dq1 * m11 + dq2 * m12, dq0 * m20 + dq1 * m21 + dq2 * m22  # fmt: skip
            djx, djxz = ta0 * r00 + ta1 * r01 + ta2 * r02, ta0 * r20 + ta1 * r21 + ta2 * r22
            djy, djyz = tb0 * r10 + tb1 * r11 + tb2 * r12, tb0 * r20 + tb1 * r21 + tb2 * r22
            free_x, free_y = (xz >= left) & (xz <= right), (yz >= top) & (yz <= bottom)
            fz, gz_ = jx * iz, jy * iz
            gx = jx * du - select(free_x, fz * djxz, zero)
            gy = jy * dv - select(free_y, gz_ * djyz, zero)
            gz = (
                fz * (djxz * select(free_x, two * xz, kx) - djx - du * xz * z)
                + gz_ * (djyz * select(free_y, two * yz, ky) - djy - dv * yz * z)
            )  # fmt: skip

            # 6. To the centre in the world, and to the camera
            wx, wy, wz = gx * r00 + gy * r10 + gz * r20, gx * r01 + gy * r11 + gz * r21, gx * r02 + gy * r12 + gz * r22  # fmt: skip
            if toward.shape[0] > 0:
                vx, vy, vz = rows3(toward, i)
                wx, wy, wz = wx + vx, wy + vy, wz + vz
                add_to(own, 16, -vx, counted)
                add_to(own, 17, -vy, counted)
                add_to(own, 18, -vz, counted)
            write_rows3(d_means, i, seen, wx, wy, wz)
            opacity = exp2(log2_opacity(logits, i))
            store(d_logits, i, select(seen, g0 * (one - opacity), zero))
            add_to(own, 0, gx * mx + jx * ta0, counted)
            add_to(own, 1, gx * my + jx * ta1, counted)
            add_to(own, 2, gx * mz + jx * ta2, counted)
            add_to(own, 3, gy * mx + jy * tb0, counted)
            add_to(own, 4, gy * my + jy * tb1, counted)
            add_to(own, 5, gy * mz + jy * tb2, counted)
            add_to(own, 6, gz * mx + jxz * ta0 + jyz * tb0, counted)
            add_to(own, 7, gz * my + jxz * ta1 + jyz * tb1, counted)
            add_to(own, 8, gz * mz + jxz * ta2 + jyz * tb2, counted)
            add_to(own, 9, gx, counted)
            add_to(own, 10, gy, counted)
            add_to(own, 11, gz, counted)
            add_to(own, 12, du * xz + iz * (djx - select(free_x, xz * djxz, zero)), counted)
            add_to(own, 13, dv * yz + iz * (djy - select(free_y, yz * djyz, zero)), counted)
            add_to(own, 14, du + select(free_x, zero, iz * djxz), counted)
            add_to(own, 15, dv + select(free_y, zero, iz * djyz), counted)
        store(d_camera[part], 0, sum_rows(own, _SUMS, _SIXTEEN))
        store(d_camera[part], 16, sum_rows(own, _SUMS + 256, _SIXTEEN))
