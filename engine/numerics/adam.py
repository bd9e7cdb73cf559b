"""Adam (Kingma and Ba, 2015) on whole arrays, one pass over memory, nothing allocated."""

# mypy: allow-untyped-defs, allow-untyped-calls
import math
from dataclasses import dataclass

import numpy as np

from engine.errors import InputError
from engine.kernels.jit import parallel_kernel, share_of
from engine.model import Float32

_BLOCK = 1 << 14
_BETA1, _BETA2 = 0.9, 0.999
_EPSILON = 1e-15
"""INRIA's: gradients of a mean over pixels are tiny, the usual 1e-8 would drown them."""


@dataclass(frozen=True, eq=False)
class AdamMoments:
    """Running means of a parameter's gradient and of its square, float32 in the parameter's shape."""

    first: Float32
    second: Float32

    @classmethod
    def zeros(cls, parameter: Float32) -> "AdamMoments":
        """Before the first step."""
        return cls(np.zeros_like(parameter), np.zeros_like(parameter))


def adam_step(
    parameter: Float32,
    gradient: Float32,
    moments: AdamMoments,
    rate: float,
    step: int,
    *,
    rate_rest: float | None = None,
) -> None:
    """One step, in place; the same bits whatever the number of threads.

    Parameters
    ----------
    parameter : (N, ...) float32, C-contiguous
        Written to, as are the moments; `gradient` has its shape.
    rate : float
        Step size.
    step : int
        Number of this step, counted from 1.
    rate_rest : float, optional
        For an (N, K, 3) array of SH: the step size of all coefficients but the first.

    Raises
    ------
    InputError
        If a shape or dtype is wrong, or the step is not positive.
    """
    arrays = (parameter, gradient, moments.first, moments.second)
    if any(a.shape != parameter.shape or a.dtype != np.float32 or not a.flags.c_contiguous for a in arrays):
        raise InputError(f"Adam takes C-contiguous float32 arrays of one shape, got {[a.shape for a in arrays]}")
    if step < 1:
        raise InputError(f"step is {step}, counted from 1")
    row = int(np.prod(parameter.shape[1:], dtype=np.int64)) if parameter.ndim > 1 else 1
    head = row if rate_rest is None else row // parameter.shape[1]
    correction = math.sqrt(1.0 - _BETA2**step) / (1.0 - _BETA1**step)
    _update(
        parameter.reshape(-1),
        gradient.reshape(-1),
        moments.first.reshape(-1),
        moments.second.reshape(-1),
        row,
        head,
        np.float32(rate * correction),
        np.float32((rate if rate_rest is None else rate_rest) * correction),
        np.float32(_EPSILON * math.sqrt(1.0 - _BETA2**step)),
    )


@parallel_kernel
def _update(parameter, gradient, first, second, row, head, rate, rate_rest, epsilon, call):
    """`head` leading numbers of every row of `row` numbers move at `rate`, the others at `rate_rest`."""
    size = parameter.shape[0]
    b1, b2 = np.float32(_BETA1), np.float32(_BETA2)
    r1, r2 = np.float32(1.0 - _BETA1), np.float32(1.0 - _BETA2)
    rows_each = max(1, _BLOCK // row)
    rows = size // row
    for block in share_of((rows + rows_each - 1) // rows_each, call):
        for i in range(block * rows_each, min(rows, (block + 1) * rows_each)):
            for begin, end, step in ((i * row, i * row + head, rate), (i * row + head, (i + 1) * row, rate_rest)):
                for k in range(begin, end):
                    g = gradient[k]
                    m = b1 * first[k] + r1 * g
                    v = b2 * second[k] + r2 * g * g
                    first[k] = m
                    second[k] = v
                    parameter[k] -= step * m / (np.sqrt(v) + epsilon)
