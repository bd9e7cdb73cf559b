"""Kernels of `view_search`: what a picture's edges say for every view, roll, size and place."""

# mypy: allow-untyped-defs

import numpy as np
from numba import prange

from engine.numerics.jit import parallel_kernel

__all__ = ["BEYOND", "BINS", "PAD", "ROLLS", "SIDE", "look_again", "score_views"]

_KERNEL_VERSION = 2
SIDE = 96
"""Longer side of the picture that is searched, and of the views, pixels."""
BINS = 8
"""Directions of edges told apart, in half a turn."""
ROLLS = 24
"""Rolls tried in a whole turn."""
BEYOND = SIDE // 4
"""Pixels by which the middle of the model may lie outside the picture."""
PAD = 2 * SIDE
"""Pixels of nothing kept around the picture: points of a view may lie so far outside."""
_LEAST_INSIDE = 0.35
"""Share of a view's points that must lie in the picture."""


@parallel_kernel
def look_again(maps, inside, places, directions, views, starts, scores, poses):
    """The best pose near each of F finds: roll within 7.5 degrees, size within 11 %, place within 2 pixels.

    Parameters
    ----------
    maps, inside : (BINS, h, w), (h, w) float32
        Responses and 1 inside the picture, padded by PAD pixels.
    views : (F,) int64
    starts : (F, 4)
        Roll, radians; size, pixels; x, y of the middle, pixels.
    scores, poses : (F,), (F, 4) out
    """
    points = directions.shape[1]
    for f in prange(views.shape[0]):
        view = views[f]
        best = np.float32(-1e9)
        columns, rows = np.empty(points, dtype=np.int64), np.empty(points, dtype=np.int64)
        bins = np.empty(points, dtype=np.int64)
        for turn in range(-2, 3):
            angle = starts[f, 0] + turn * (np.pi / ROLLS / 2.0)
            c, s = np.cos(angle), np.sin(angle)
            for p in range(points):
                bins[p] = int(np.floor((directions[view, p] + angle) * BINS / np.pi + 0.5)) % BINS
            for grow in range(-2, 3):
                radius = starts[f, 1] * (1.0 + 0.055 * grow)
                for p in range(points):
                    x, y = places[view, p, 0] * radius, places[view, p, 1] * radius
                    columns[p] = int(np.floor(c * x - s * y + 0.5)) + PAD + int(starts[f, 2])
                    rows[p] = int(np.floor(s * x + c * y + 0.5)) + PAD + int(starts[f, 3])
                for dy in range(-2, 3):
                    for dx in range(-2, 3):
                        said, counted = 0.0, 0.0
                        for p in range(points):
                            row, column = rows[p] + dy, columns[p] + dx
                            if row < 0 or column < 0 or row >= maps.shape[1] or column >= maps.shape[2]:
                                continue
                            said += maps[bins[p], row, column]
                            counted += inside[row, column]
                        if counted >= _LEAST_INSIDE * points and said / np.sqrt(counted) > best:
                            best = said / np.sqrt(counted)
                            poses[f, 0], poses[f, 1] = angle, radius
                            poses[f, 2], poses[f, 3] = starts[f, 2] + dx, starts[f, 3] + dy
        scores[f] = best


@parallel_kernel
def score_views(maps, places, directions, radii, size, scores, found):
    """Best place of every view, roll and size.

    Parameters
    ----------
    maps : (BINS, 2, 2, h, w) float32
        Responses, odd and even rows and columns apart, padded by PAD pixels.
    places, directions : (V, P, 2), (V, P) float32
        Of the views' points, from their middle in units of their spread; radians.
    radii : (S,) float32, pixels
    size : (2,) height and width of the picture
    scores : (V, ROLLS, S) out
        Sum of responses over the root of how many points lie in the picture.
    found : (V, ROLLS, S, 2) out
        x, y of the middle there, pixels.
    """
    views, points = directions.shape
    height, width = size[0], size[1]
    rows, columns = (height + 2 * BEYOND) // 2, (width + 2 * BEYOND) // 2
    roots = np.sqrt(np.arange(points + 1).astype(np.float32))
    for job in prange(views * ROLLS):
        view, roll = job // ROLLS, job % ROLLS
        angle = 2.0 * np.pi * roll / ROLLS
        c, s = np.cos(angle), np.sin(angle)
        said = np.empty((rows, columns), dtype=np.float32)
        counted = np.empty((rows + 1, columns + 1), dtype=np.int32)
        for k in range(radii.shape[0]):
            said[:] = np.float32(0.0)
            counted[:] = 0
            for p in range(points):
                x, y = places[view, p, 0] * radii[k], places[view, p, 1] * radii[k]
                column = int(np.floor(c * x - s * y + 0.5)) - BEYOND
                row = int(np.floor(s * x + c * y + 0.5)) - BEYOND
                # of the places tried, those that put this point into the picture
                left, right = max(0, (1 - column) // 2), min(columns, (width - column + 1) // 2)
                top, bottom = max(0, (1 - row) // 2), min(rows, (height - row + 1) // 2)
                if left >= right or top >= bottom:
                    continue
                bin = int(np.floor((directions[view, p] + angle) * BINS / np.pi + 0.5)) % BINS
                one = maps[bin, (row + PAD) % 2, (column + PAD) % 2]
                above, before = (row + PAD) // 2, (column + PAD) // 2
                for j in range(top, bottom):
                    line, sums = one[above + j, before + left : before + right], said[j, left:right]
                    for i in range(len(sums)):  # from 0: what may be negative is not vectorised
                        sums[i] += line[i]
                counted[top, left] += 1  # summed up below, each is a rectangle
                counted[top, right] -= 1
                counted[bottom, left] -= 1
                counted[bottom, right] += 1
            best = np.float32(-1e9)
            for j in range(rows):
                along = 0
                for i in range(columns):
                    along += counted[j, i]
                    counted[j, i] = along + (counted[j - 1, i] if j > 0 else 0)
                    inside = counted[j, i]
                    if inside >= _LEAST_INSIDE * points and said[j, i] > best * roots[inside]:
                        best = said[j, i] / roots[inside]
                        found[view, roll, k, 0], found[view, roll, k, 1] = 2 * i - BEYOND, 2 * j - BEYOND
            scores[view, roll, k] = best
