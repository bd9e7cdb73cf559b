"""On sixteen lanes: exponential and logarithm to base 2, three-vectors, and 3 x 3 matrices (nine entries, row by row).

Vectors and matrices serve float32 scalars, too.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-untyped-calls
from typing import Any

import numpy as np

# mypy: allow-untyped-defs, allow-untyped-calls
from engine.kernels.jit import inlined
from engine.raster.lane_ir import FLOATS, INTS, floats, ints
from engine.raster.lanes import fused, ir_function, lanes

_ROUND = 12582912.0
"""1.5 * 2^23: adding it rounds a float32 below 2^22 to the nearest integer and leaves that in the low bits."""


def _least_squares(function: Any, low: float, high: float, degree: int, relative: bool) -> list[float]:
    """Polynomial in x, lowest power first, close to minimax: least squares on Chebyshev nodes."""
    x = (low + high) / 2 + (high - low) / 2 * np.cos(np.pi * (np.arange(400) + 0.5) / 400)
    target = function(x)
    weight = 1.0 / target if relative else np.ones_like(x)
    rows = np.vander(x, degree + 1, increasing=True) * weight[:, None]
    return [float(c) for c in np.linalg.lstsq(rows, target * weight, rcond=None)[0]]


_EXP2 = _least_squares(lambda f: 2.0**f, -0.5, 0.5, 5, relative=True)
"""Degree 5: relative error 2e-7; degree 4 is no faster (latency bound)."""

_LOG2 = _least_squares(lambda f: np.log2(1.0 + f) / f, np.sqrt(0.5) - 1.0, np.sqrt(2.0) - 1.0, 8, relative=False)
"""log2(1 + f) / f for f in [sqrt(1/2) - 1, sqrt(2) - 1]: absolute error of the logarithm below 2e-7."""


def _horner(b: Any, coefficients: list[float], x: Any) -> Any:
    value = floats(coefficients[-1])
    for c in coefficients[-2::-1]:
        value = fused(b, value, x, floats(c))
    return value


@ir_function(lanes, lanes)
def exp2(b, x):
    """2^x for |x| <= 126, relative error 2e-7. Outside, garbage (but never a trap): the caller masks or clamps."""
    # No fast-math flags on the two additions of the constant: they are the rounding.
    shifted = b.fadd(x, floats(_ROUND))
    fraction = b.fsub(x, b.fsub(shifted, floats(_ROUND)))  # in [-1/2, 1/2]
    exponent = b.shl(b.bitcast(shifted, INTS), ints(23))
    return b.bitcast(b.add(b.bitcast(_horner(b, _EXP2, fraction), INTS), exponent), FLOATS)


@ir_function(lanes, lanes)
def log2(b, x):
    """log2(x) for positive normal x, absolute error about 2e-7 plus rounding."""
    bits = b.bitcast(x, INTS)
    # Exponent such that the mantissa lies in [sqrt(1/2), sqrt(2)).
    half = int(np.float32(np.sqrt(0.5)).view(np.int32))
    exponent = b.ashr(b.sub(bits, ints(half)), ints(23))
    mantissa = b.bitcast(b.sub(bits, b.shl(exponent, ints(23))), FLOATS)
    fraction = b.fsub(mantissa, floats(1.0))
    series = b.fmul(_horner(b, _LOG2, fraction), fraction)
    return b.fadd(b.sitofp(exponent, FLOATS), series)


@inlined
def dot(u, v):
    """u . v"""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inlined
def cross(u, v):
    """u x v"""
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


@inlined
def add(u, v):
    """u + v"""
    return (u[0] + v[0], u[1] + v[1], u[2] + v[2])


@inlined
def times(m, v):
    """M v"""
    return (dot(m[0:3], v), dot(m[3:6], v), dot(m[6:9], v))


@inlined
def row_times(v, m):
    """v^T M"""
    return (
        v[0] * m[0] + v[1] * m[3] + v[2] * m[6],
        v[0] * m[1] + v[1] * m[4] + v[2] * m[7],
        v[0] * m[2] + v[1] * m[5] + v[2] * m[8],
    )


@inlined
def scale_columns(m, s):
    """M diag(s)"""
    return (
        m[0] * s[0],
        m[1] * s[1],
        m[2] * s[2],
        m[3] * s[0],
        m[4] * s[1],
        m[5] * s[2],
        m[6] * s[0],
        m[7] * s[1],
        m[8] * s[2],
    )
