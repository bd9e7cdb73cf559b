"""Kernels of chips that respond alike to a mark: what their classes say together, and what each then counts for."""

# mypy: allow-untyped-defs

from engine.kernels.jit import parallel_kernel, share_of
from engine.numerics.tables import first_at_least

__all__ = ["scale_alike", "sum_alike"]


@parallel_kernel
def sum_alike(y, weights, signal, edges, sums, rows, call):
    """Of each block of so many `rows` of chips, to `sums` (B, 2, A): by classes of |w s| between `edges` (A - 1,), the
    sums of w s and of (w y)^2, of chips whose w s is not 0."""
    for block in share_of(len(sums), call):
        for i in range(block * rows, min((block + 1) * rows, len(y))):
            answer = weights[i] * signal[i]
            if answer != 0.0:
                alike = first_at_least(edges, abs(answer))
                sums[block, 0, alike] += answer
                sums[block, 1, alike] += (weights[i] * y[i]) ** 2


@parallel_kernel
def scale_alike(y, weights, signal, edges, scales, call):
    """Multiply y and s of each chip by what its class is scaled by; those whose w s is 0 become 0."""
    for i in share_of(len(y), call):
        answer = weights[i] * signal[i]
        scale = scales[first_at_least(edges, abs(answer))] if answer != 0.0 else 0.0
        y[i] *= scale
        signal[i] *= scale
