"""Do the keypoints that voted for a view lie as they lay there? One turn, size and shift must carry them over.

What else a picture shows - another model, the photograph behind it - votes for views all over the index, here and
there. A picture of the asset puts many votes into one view of 48, in their places.
"""

# mypy: allow-untyped-defs

import numba
import numpy as np

from engine.model import Float64, Int64
from engine.numerics.jit import parallel_kernel, parallel_section

__all__ = ["agreement_of_views"]

_KERNEL_VERSION = 1

MOST = 64
"""Votes of a view that are looked at, the loudest: a mask of bits holds who was counted."""
APART = 8.0
"""Least distance of the two votes that say how a view was turned, sized and shifted, pixels."""
TOLERANCE = 20.0
"""How far a place may lie from where it should be, pixels of a view of 640: another view point moves what is nearer."""
SMALLEST, LARGEST = 0.1, 10.0
"""Sizes of the picture in the view."""


@parallel_kernel
def _agreements(starts, x, y, u, v, spot, place, gain, best):
    """best (V,) of each slice of votes: the loudest sum that one map of (x, y) to (u, v) carries over, each spot and
    each place counted once."""
    for n in numba.prange(len(starts) - 1):
        begin, end = starts[n], starts[n + 1]
        most = 0.0
        for i in range(begin, end):
            for j in range(i + 1, end):
                dx, dy, du, dv = x[j] - x[i], y[j] - y[i], u[j] - u[i], v[j] - v[i]
                here, there = dx * dx + dy * dy, du * du + dv * dv
                if here < APART * APART or there < APART * APART:
                    continue
                if there < SMALLEST * SMALLEST * here or there > LARGEST * LARGEST * here:
                    continue
                a, b = (du * dx + dv * dy) / here, (dv * dx - du * dy) / here
                total = 0.0
                spots, places = np.uint64(0), np.uint64(0)
                for k in range(begin, end):
                    off_u = a * (x[k] - x[i]) - b * (y[k] - y[i]) + u[i] - u[k]
                    off_v = b * (x[k] - x[i]) + a * (y[k] - y[i]) + v[i] - v[k]
                    if off_u * off_u + off_v * off_v > TOLERANCE * TOLERANCE:
                        continue
                    one = np.uint64(1)
                    mine, its = one << np.uint64(spot[k]), one << np.uint64(place[k])
                    if (spots & mine) != np.uint64(0) or (places & its) != np.uint64(0):
                        continue
                    spots |= mine
                    places |= its
                    total += gain[k]
                most = max(most, total)
        best[n] = most


def agreement_of_views(view: Int64, spots: Float64, places: Float64, gain: Float64) -> tuple[Int64, Float64]:
    """The views (V,) that were voted for, ascending, and how much of the votes for each agrees (V,).

    Parameters
    ----------
    view : (N,)
        For which each vote is.
    spots, places : (N, 2)
        x, y of the keypoint in the picture, and of the landmark in the view, pixels.
    gain : (N,)
        How loud it is.
    """
    order = np.lexsort((-gain, view))
    names, begin = np.unique(view[order], return_index=True)
    rank = np.arange(len(order)) - np.repeat(begin, np.diff(np.append(begin, len(order))))
    order = order[rank < MOST]
    begin = np.append(np.unique(view[order], return_index=True)[1], len(order)).astype(np.int64)
    x, y = np.ascontiguousarray(spots[order].T)
    u, v = np.ascontiguousarray(places[order].T)
    best = np.zeros(len(names))
    with parallel_section():
        _agreements(begin, x, y, u, v, _numbered(x, y, begin), _numbered(u, v, begin), gain[order], best)
    return names, best


def _numbered(x: Float64, y: Float64, starts: Int64) -> Int64:
    """(N,) within each slice: the same number for points within about three pixels of each other."""
    slot = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    cell = np.stack([slot, np.floor(x / 3.0), np.floor(y / 3.0)], axis=1).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)  # rising with the slice
    number = number.reshape(-1)
    first = np.full(len(starts) - 1, np.iinfo(np.int64).max)
    np.minimum.at(first, slot, number)
    return np.asarray(number - first[slot])
