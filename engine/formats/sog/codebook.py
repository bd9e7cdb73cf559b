"""The best 256 values for many: the scalar codebooks of SOG."""

# mypy: allow-untyped-defs

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.kernels.jit import inlined, kernel
from engine.model import Float32, Float64

LEVELS = 256
_CELLS = 1 << 12
"""Half of the cells that the dynamic programme may cut between."""

_ROUNDS = 300


def learn_codebook(values: npt.NDArray[Any], weights: npt.NDArray[Any] | None = None, levels: int = LEVELS) -> Float32:
    """(levels,) float32 values, ascending, of least squared error to the nearest of finite `values` of any shape.

    `weights`, of the same shape, say how often each counts: not negative, not all zero. Padded with the largest value
    where fewer are needed; values that take at most `levels` different numbers are kept exactly.

    Values are gathered into cells, at most 4096 of equal width and 4096 of equal number, over which dynamic programming
    finds the best cuts (Bruce 1965, with the divide and conquer that monotone cuts allow); Lloyd's iteration over all
    values then moves the cuts off the borders of the cells, until nothing changes.
    """
    flat = np.asarray(values, dtype=np.float32).reshape(-1)
    order = np.argsort(flat, kind="stable") if weights is not None else None
    x = np.sort(flat) if order is None else flat[order]
    changes = np.flatnonzero(np.diff(x, prepend=np.float32(np.nan)) != 0)  # where a new value begins
    if len(changes) <= levels:
        distinct = x[changes]
        return np.concatenate([distinct, np.full(levels - len(distinct), distinct[-1], dtype=np.float32)])
    y = x - np.mean(x, dtype=np.float64)  # sums of squares then lose no digits to a common offset
    w = np.ones(len(x)) if weights is None or order is None else np.asarray(weights).reshape(-1)[order]
    mass, moment = _prefix(w), _prefix(w * y)
    starts = _cell_starts(x, changes)
    bounds = np.concatenate([starts, [len(x)]])
    cuts, room = np.empty(levels + 1, np.int64), len(bounds)
    scratch = np.empty((2, room)), np.zeros((levels, room), np.int32), np.empty((64, 4), np.int64)
    _find_cuts(mass[bounds], moment[bounds], _prefix(w * y * y)[bounds], scratch, cuts)
    split = bounds[cuts]
    centers = np.zeros(levels)
    for _ in range(_ROUNDS):
        held = np.diff(mass[split])
        centers = np.sort(np.where(held > 0, np.diff(moment[split]) / np.where(held > 0, held, 1.0), centers))
        moved = np.concatenate([[0], np.searchsorted(y, _edges(centers)), [len(y)]])
        if (moved == split).all():
            break
        split = moved
    return (centers + np.mean(x, dtype=np.float64)).astype(np.float32)


def nearest_codes(values: npt.NDArray[Any], codebook: Float32) -> npt.NDArray[np.uint8]:
    """Index of the nearest entry of an ascending codebook of at most 256, for values of any shape."""
    edges = _edges(codebook.astype(np.float64)).astype(np.float32)
    return np.searchsorted(edges, values.astype(np.float32)).astype(np.uint8)


def _edges(centers: Float64) -> Float64:
    middle: Float64 = 0.5 * (centers[1:] + centers[:-1])
    return middle


def _prefix(values: npt.NDArray[Any]) -> Float64:
    return np.concatenate([[0.0], np.cumsum(values, dtype=np.float64)])


def _cell_starts(x: Float32, changes: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """First index of each cell of ascending x; equal values share a cell, and few values have one each."""
    if len(changes) <= 2 * _CELLS:
        return changes.astype(np.int64)
    by_value = np.searchsorted(x, np.linspace(float(x[0]), float(x[-1]), _CELLS).astype(np.float32))
    by_rank = changes[np.searchsorted(changes, np.linspace(0, changes[-1], _CELLS).astype(np.int64))]
    starts = np.union1d(by_value, by_rank)
    return starts[starts < len(x)].astype(np.int64)


@inlined
def _cost(mass, moment, square, first, last):
    """Squared error of the cells first..last-1 to their mean."""
    m = mass[last] - mass[first]
    if m <= 0.0:
        return 0.0
    s = moment[last] - moment[first]
    return max(square[last] - square[first] - s * s / m, 0.0)


@kernel
def _find_cuts(mass, moment, square, scratch, cuts):
    """The borders `cuts` (levels + 1,) among the cells that minimise the total cost, from prefix sums (cells + 1,)."""
    n, levels = len(mass) - 1, len(cuts) - 1
    before, best, came_from, stack = scratch[0][0], scratch[0][1], scratch[1], scratch[2]
    for j in range(n + 1):
        before[j] = _cost(mass, moment, square, 0, j)
    for level in range(1, levels):
        # best[j] = min over i of before[i] + cost(i, j); the minimising i grows with j.
        for j in range(level):
            best[j] = 0.0
        top = 1
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = level, n, level - 1, n
        while top > 0:
            top -= 1
            low, high, i_low, i_high = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
            j = (low + high) // 2
            least, at = np.inf, i_low
            for i in range(i_low, min(j, i_high) + 1):
                total = before[i] + _cost(mass, moment, square, i, j)
                if total < least:
                    least, at = total, i
            best[j], came_from[level, j] = least, at
            if low < j:
                stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = low, j - 1, i_low, at
                top += 1
            if j < high:
                stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = j + 1, high, at, i_high
                top += 1
        for j in range(n + 1):
            before[j] = best[j]
    cuts[levels] = n
    for level in range(levels - 1, 0, -1):
        cuts[level] = came_from[level, cuts[level + 1]]
    cuts[0] = 0
