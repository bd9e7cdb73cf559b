"""Do the keypoints that voted for a view lie as they lay there? One turn, size and shift must carry them over.

What else a picture shows - another model, the photograph behind it - votes for views all over the index, here and
there. A picture of the asset puts many votes into one view of 48, in their places.
"""

# mypy: allow-untyped-defs

import math

import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.model import Float64, Int64
from engine.pictures.camera.config import CONFIG

MOST = 64
"""Votes of a view that are looked at, the loudest: a mask of bits holds who was counted."""
APART, TOLERANCE = CONFIG.votes.apart, CONFIG.votes.tolerance
SMALLEST, LARGEST = CONFIG.votes.sizes


@inlined
def _reach(a, b):
    """Squared error that is allowed, pixels of the view."""
    return TOLERANCE * TOLERANCE * min(1.0, math.sqrt(a * a + b * b))


@inlined
def _fitted(carried, begin, end, x, y, u, v, gain):
    """Moves a map (4,) to the one that carries what it carries with the least squares of errors."""
    a, b, c, d = carried
    tolerance = _reach(a, b)
    total, mx, my, mu, mv, square, along, across = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(begin, end):
        off_u, off_v = a * x[k] - b * y[k] + c - u[k], b * x[k] + a * y[k] + d - v[k]
        if off_u * off_u + off_v * off_v <= tolerance:
            g = gain[k]
            total += g
            mx, my, mu, mv = mx + g * x[k], my + g * y[k], mu + g * u[k], mv + g * v[k]
            square += g * (x[k] * x[k] + y[k] * y[k])
            along += g * (u[k] * x[k] + v[k] * y[k])
            across += g * (v[k] * x[k] - u[k] * y[k])
    square -= (mx * mx + my * my) / total
    along -= (mu * mx + mv * my) / total
    across -= (mv * mx - mu * my) / total
    a, b = along / square, across / square
    carried[0], carried[1] = a, b
    carried[2], carried[3] = (mu - a * mx + b * my) / total, (mv - b * mx - a * my) / total


@parallel_kernel
def _agreements(starts, x, y, u, v, spot, place, gain, best, maps, call):
    """best (V,) of each slice of votes: the loudest sum that one map of (x, y) to (u, v) carries over, each spot and
    each place counted once; and those maps (V, 4)."""
    for n in share_of(len(starts) - 1, call):
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
                tolerance = _reach(a, b)
                total = 0.0
                spots, places = np.uint64(0), np.uint64(0)
                for k in range(begin, end):
                    off_u = a * (x[k] - x[i]) - b * (y[k] - y[i]) + u[i] - u[k]
                    off_v = b * (x[k] - x[i]) + a * (y[k] - y[i]) + v[i] - v[k]
                    if off_u * off_u + off_v * off_v > tolerance:
                        continue
                    one = np.uint64(1)
                    mine, its = one << np.uint64(spot[k]), one << np.uint64(place[k])
                    if (spots & mine) != np.uint64(0) or (places & its) != np.uint64(0):
                        continue
                    spots |= mine
                    places |= its
                    total += gain[k]
                if total > most:
                    most = total
                    maps[n, 0], maps[n, 1] = a, b
                    maps[n, 2], maps[n, 3] = u[i] - a * x[i] + b * y[i], v[i] - b * x[i] - a * y[i]
        best[n] = most
        if most > 0.0:
            _fitted(maps[n], begin, end, x, y, u, v, gain)


def agreement_of_views(view: Int64, spots: Float64, places: Float64, gain: Float64) -> tuple[Int64, Float64, Float64]:
    """The views (V,) that were voted for, ascending, how much of the votes for each agrees (V,), and the maps (V, 4)
    that they agree on: a, b, c, d of u = a x - b y + c, v = b x + a y + d.

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
    best, maps = np.zeros(len(names)), np.zeros((len(names), 4))
    _agreements(begin, x, y, u, v, _numbered(x, y, begin), _numbered(u, v, begin), gain[order], best, maps)
    return names, best, maps


def _numbered(x: Float64, y: Float64, starts: Int64) -> Int64:
    """(N,) within each slice: the same number for points within about three pixels of each other."""
    slot = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    cell = np.stack([slot, np.floor(x / 3.0), np.floor(y / 3.0)], axis=1).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)  # rising with the slice
    number = number.reshape(-1)
    first = np.full(len(starts) - 1, np.iinfo(np.int64).max)
    np.minimum.at(first, slot, number)
    return np.asarray(number - first[slot])
