"""Spherical harmonics, sixteen Gaussians at a time: colours from coefficients, and back.

The basis is evaluated with one Gaussian per lane and transposed, so that a Gaussian's coefficients, which
lie next to each other, meet its basis values in one multiplication per channel.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.model import SH_C0
from engine.numerics.spherical_harmonics import SH_C1, SH_C2, SH_C3
from engine.raster.lane_memory import load, load_some, store, store_some, sum_rows, transpose
from engine.raster.lane_order import unzip3, zip3
from engine.raster.lanes import maximum, root, spread

SH_SCRATCH = 3 * 16 + 5 * 256
"""Floats of scratch a share needs: directions, basis, transposed basis, three blocks of products."""

_f = np.float32
_i = np.int32
_BASIS, TURNED, _PRODUCTS = 48, 48 + 256, 48 + 512
_SIXTEEN = (0,) * 16
_C0, _C1 = _f(SH_C0), _f(SH_C1)
_C20, _C21, _C22 = (_f(c) for c in SH_C2)
_C30, _C31, _C32, _C33, _C34 = (_f(c) for c in SH_C3)


@inlined
def unit_directions(own):
    """The 16 directions at own[0:48] (x, y, z rows, any length) at unit length, and what they were multiplied by."""
    x, y, z = load(own, 0), load(own, 16), load(own, 32)
    scale = spread(_f(1.0)) / root(maximum(x * x + y * y + z * z, _f(1e-30)))
    return x * scale, y * scale, z * scale, scale


@inlined
def load_colors(array, at, row):
    """(r, g, b) of the first `row` / 3 <= 16 colours from array[at] on, zeros after them."""
    if row == 48:
        return unzip3(load(array, at), load(array, at + 16), load(array, at + 32))
    return unzip3(
        load_some(array, at, _i(row)), load_some(array, at + 16, _i(row - 16)), load_some(array, at + 32, _i(row - 32))
    )


@inlined
def store_colors(array, at, row, end, r, g, b):
    """The first `row` / 3 <= 16 colours to array[at] and on; what stands between them and `end` may be overwritten.

    Masked stores take microcode on processors without AVX-512.
    """
    first, second, third = zip3(r, g, b)
    if at + 48 <= end:
        store(array, at, first)
        if row > 16:
            store(array, at + 16, second)
        if row > 32:
            store(array, at + 32, third)
        return
    store_some(array, at, _i(row), first)
    store_some(array, at + 16, _i(row - 16), second)
    store_some(array, at + 32, _i(row - 32), third)


@inlined
def sh_lanes(own, coefficients):
    """Basis values of the 16 directions at own[0:48], transposed: 16 of one Gaussian a row."""
    x, y, z, _ = unit_directions(own)
    for k in range(coefficients, 16):
        store(own, _BASIS + k * 16, spread(_f(0.0)))
    store(own, _BASIS, spread(_C0))
    if coefficients > 1:
        store(own, _BASIS + 16, y * -_C1)
        store(own, _BASIS + 32, z * _C1)
        store(own, _BASIS + 48, x * -_C1)
    if coefficients > 4:
        xx, yy, zz = x * x, y * y, z * z
        store(own, _BASIS + 64, x * y * _C20)
        store(own, _BASIS + 80, y * z * -_C20)
        store(own, _BASIS + 96, (zz + zz - xx - yy) * _C21)
        store(own, _BASIS + 112, x * z * -_C20)
        store(own, _BASIS + 128, (xx - yy) * _C22)
        if coefficients > 9:
            store(own, _BASIS + 144, y * (xx * _f(3.0) - yy) * -_C30)
            store(own, _BASIS + 160, x * y * z * _C31)
            store(own, _BASIS + 176, y * (zz * _f(4.0) - xx - yy) * -_C32)
            store(own, _BASIS + 192, z * (zz * _f(2.0) - (xx + yy) * _f(3.0)) * _C33)
            store(own, _BASIS + 208, x * (zz * _f(4.0) - xx - yy) * -_C32)
            store(own, _BASIS + 224, z * (xx - yy) * _C34)
            store(own, _BASIS + 240, x * (xx - yy * _f(3.0)) * -_C30)
    transpose(own, _BASIS, TURNED)


@inlined
def set_direction(own, lane, means, i, position):
    """Direction from the camera to Gaussian i, in one lane; not normalised."""
    own[lane] = means[3 * i] - position[0]
    own[16 + lane] = means[3 * i + 1] - position[1]
    own[32 + lane] = means[3 * i + 2] - position[2]


@parallel_kernel
def evaluate_sh(sh, coefficients, means, position, wanted, scratch, rows, colors, call):
    """colors[i] = max(0, 0.5 + sum_k Y_k sh[i, k]).

    `sh`, `means` and `colors` are flat. `wanted` (N,) int32 leaves out Gaussians where it is 0; empty: none
    is left out. `scratch` (shares, SH_SCRATCH) and `rows` (shares, 16) int64 have one row per
    share of the Gaussians.
    """
    n = means.shape[0] // 3
    shares = scratch.shape[0]
    share = (n + shares - 1) // shares
    row = 3 * coefficients
    for part in share_of(shares, call):
        own = scratch[part]
        who = rows[part]
        i, end = part * share, min(n, (part + 1) * share)
        while i < end:
            filled = 0
            while i < end and filled < 16:
                if wanted.shape[0] == 0 or wanted[i] != 0:
                    who[filled] = i
                    set_direction(own, filled, means, i, position)
                    filled += 1
                i += 1
            sh_lanes(own, coefficients)
            for g in range(filled):
                at = who[g] * row
                r, g_, b = load_colors(sh, at, row)
                y = load(own, TURNED + g * 16)
                store(own, _PRODUCTS + g * 16, r * y)
                store(own, _PRODUCTS + 256 + g * 16, g_ * y)
                store(own, _PRODUCTS + 512 + g * 16, b * y)
            for channel in range(3):
                value = sum_rows(own, _PRODUCTS + channel * 256, _SIXTEEN) + _f(0.5)
                store(own, _BASIS + channel * 16, maximum(value, _f(0.0)))
            for g in range(filled):
                for channel in range(3):
                    colors[who[g] * 3 + channel] = own[_BASIS + channel * 16 + g]


@inlined
def direction_gradient(own, coefficients):
    """d/d(unit direction) of sum_k h_k Y_k for 16 Gaussians; h_k are the rows at _PRODUCTS."""
    x, y, z, scale = unit_directions(own)
    gx = load(own, _PRODUCTS + 48) * -_C1
    gy = load(own, _PRODUCTS + 16) * -_C1
    gz = load(own, _PRODUCTS + 32) * _C1
    if coefficients > 4:
        h4, h5, h6 = load(own, _PRODUCTS + 64), load(own, _PRODUCTS + 80), load(own, _PRODUCTS + 96)
        h7, h8 = load(own, _PRODUCTS + 112), load(own, _PRODUCTS + 128)
        two = _f(2.0)
        gx += (y * h4 - z * h7) * _C20 - x * h6 * (two * _C21) + x * h8 * (two * _C22)
        gy += (x * h4 - z * h5) * _C20 - y * h6 * (two * _C21) - y * h8 * (two * _C22)
        gz += z * h6 * (_f(4.0) * _C21) - (y * h5 + x * h7) * _C20
        if coefficients > 9:
            h9, h10 = load(own, _PRODUCTS + 144), load(own, _PRODUCTS + 160)
            h11, h12 = load(own, _PRODUCTS + 176), load(own, _PRODUCTS + 192)
            h13, h14 = load(own, _PRODUCTS + 208), load(own, _PRODUCTS + 224)
            h15 = load(own, _PRODUCTS + 240)
            xx, yy, zz, xy = x * x, y * y, z * z, x * y
            three, six, eight = _f(3.0), _f(6.0), _f(8.0)
            gx += (
                (xy * h9 * six + (xx - yy) * h15 * three) * -_C30
                + (y * h10) * z * _C31
                + (xy * h11 * two - (zz * _f(4.0) - xx * three - yy) * h13) * _C32
                - x * z * h12 * (six * _C33)
                + x * z * h14 * (two * _C34)
            )
            gy += (
                ((xx - yy) * h9 * three - xy * h15 * six) * -_C30
                + (x * h10) * z * _C31
                - ((zz * _f(4.0) - xx - yy * three) * h11 - xy * h13 * two) * _C32
                - y * z * h12 * (six * _C33)
                - y * z * h14 * (two * _C34)
            )
            gz += (
                xy * h10 * _C31
                - z * (y * h11 + x * h13) * (eight * _C32)
                + (zz * six - (xx + yy) * three) * h12 * _C33
                + (xx - yy) * h14 * _C34
            )
    return gx, gy, gz, x, y, z, scale


@inlined
def differentiate_group(own, sh, coefficients, first, size, end, mean, position, values, d_sh):
    """d_sh[i, k] = Y_k values[i] of up to 16 Gaussians from row `first` on; returns dL/dmeans by way of the direction.

    mean : their centres (lanes); values : dL/dcolors (lanes), 0 where the colour was clamped; only rows below `end` may
    be written.
    """
    row = 3 * coefficients
    for axis in range(3):
        store(own, axis * 16, mean[axis] - position[axis])
    sh_lanes(own, coefficients)
    for channel in range(3):
        store(own, _PRODUCTS + 256 + channel * 16, values[channel])
    for g in range(size):
        at = (first + g) * row
        y = load(own, TURNED + g * 16)
        v0, v1, v2 = own[_PRODUCTS + 256 + g], own[_PRODUCTS + 272 + g], own[_PRODUCTS + 288 + g]
        store_colors(d_sh, at, row, end * row, y * v0, y * v1, y * v2)
        r, g_, b = load_colors(sh, at, row)
        store(own, _BASIS + g * 16, r * v0 + g_ * v1 + b * v2)
    transpose(own, _BASIS, _PRODUCTS)
    gx, gy, gz, x, y_, z, scale = direction_gradient(own, coefficients)
    along = gx * x + gy * y_ + gz * z  # a unit vector moves only across itself
    return (gx - along * x) * scale, (gy - along * y_) * scale, (gz - along * z) * scale
