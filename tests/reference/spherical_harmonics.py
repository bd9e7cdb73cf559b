"""Real spherical harmonics from associated Legendre functions (scipy), in INRIA's signs."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import lpmv


def sh_value(l: int, m: int, direction: np.ndarray) -> float:
    """Y_lm at one unit direction. scipy's lpmv carries the Condon-Shortley phase, as INRIA's basis does."""
    x, y, z = (float(v) for v in direction)
    phi = math.atan2(y, x)
    k = abs(m)
    norm = math.sqrt((2 * l + 1) / (4 * math.pi) * math.factorial(l - k) / math.factorial(l + k))
    legendre = float(lpmv(k, l, z))
    if m == 0:
        return norm * legendre
    return math.sqrt(2) * norm * legendre * (math.cos(k * phi) if m > 0 else math.sin(k * phi))


def sh_colour(sh: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Colour (3,) of coefficients (K, 3) from one unit direction, before the clamp at 0."""
    degree = math.isqrt(len(sh)) - 1
    terms = [(l, m) for l in range(degree + 1) for m in range(-l, l + 1)]
    return 0.5 + sum((sh_value(l, m, direction) * sh[k] for k, (l, m) in enumerate(terms)), start=np.zeros(3))
