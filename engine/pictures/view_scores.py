"""Kernels of `view_search`: what a picture's edges say for every view, roll, size and place."""

# mypy: allow-untyped-defs

import numpy as np
from numba import prange

from engine.numerics.jit import parallel_kernel

__all__ = ["BEYOND", "BINS", "PAD", "ROLLS", "SIDE", "look_again", "score_views"]

_KERNEL_VERSION = 1
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
        As of `score_views`, rows and columns together.
    views : (F,) int64
    starts : (F, 4)
        Roll, radians; size, pixels; x, y of the middle, pixels.
    scores, poses : (F,), (F, 4) out
    """
    points = directions.shape[1]
    for f in prange(views.shape[0]):
        view = views[f]
        best = np.float32(-1e9)
        for turn in range(-2, 3):
            angle = starts[f, 0] + turn * (np.pi / ROLLS / 2.0)
            c, s = np.cos(angle), np.sin(angle)
            for grow in range(-2, 3):
                radius = starts[f, 1] * (1.0 + 0.055 * grow)
                for dy in range(-2, 3):
                    for dx in range(-2, 3):
                        said, counted = 0.0, 0.0
                        for p in range(points):
                            x, y = places[view, p, 0] * radius, places[view, p, 1] * radius
                            column = int(np.floor(c * x - s * y + 0.5)) + PAD + int(starts[f, 2]) + dx
                            row = int(np.floor(s * x + c * y + 0.5)) + PAD + int(starts[f, 3]) + dy
                            if row < 0 or column < 0 or row >= maps.shape[1] or column >= maps.shape[2]:
                                continue
                            bin = int(np.floor((directions[view, p] + angle) * BINS / np.pi + 0.5)) % BINS
                            said += maps[bin, row, column]
                            counted += inside[row, column]
                        if counted >= _LEAST_INSIDE * points and said / np.sqrt(counted) > best:
                            best = said / np.sqrt(counted)
                            poses[f, 0], poses[f, 1] = angle, radius
                            poses[f, 2], poses[f, 3] = starts[f, 2] + dx, starts[f, 3] + dy
        scores[f] = best


@parallel_kernel
def score_views(maps, inside, places, directions, radii, size, scores, found):
    """Best place of every view, roll and size.

    Parameters
    ----------
    maps, inside : (BINS, 2, 2, h, w), (2, 2, h, w) float32
        Responses and 1 inside the picture, odd and even rows and columns apart, padded by PAD pixels.
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
    rows, columns = (size[0] + 2 * BEYOND) // 2, (size[1] + 2 * BEYOND) // 2
    for job in prange(views * ROLLS):
        view, roll = job // ROLLS, job % ROLLS
        angle = 2.0 * np.pi * roll / ROLLS
        c, s = np.cos(angle), np.sin(angle)
        said = np.empty((rows, columns), dtype=np.float32)
        counted = np.empty((rows, columns), dtype=np.float32)
        for k in range(radii.shape[0]):
            said[:] = np.float32(0.0)
            counted[:] = np.float32(0.0)
            for p in range(points):
                x, y = places[view, p, 0] * radii[k], places[view, p, 1] * radii[k]
                column = int(np.floor(c * x - s * y + 0.5)) + PAD - BEYOND
                row = int(np.floor(s * x + c * y + 0.5)) + PAD - BEYOND
                bin = int(np.floor((directions[view, p] + angle) * BINS / np.pi + 0.5)) % BINS
                if row < 0 or column < 0:
                    continue
                top, left = row // 2, column // 2
                if top + rows > maps.shape[3] or left + columns > maps.shape[4]:
                    continue
                one, edge = maps[bin, row % 2, column % 2], inside[row % 2, column % 2]
                for j in range(rows):
                    for i in range(columns):
                        said[j, i] += one[top + j, left + i]
                        counted[j, i] += edge[top + j, left + i]
            best = np.float32(-1e9)
            for j in range(rows):
                for i in range(columns):
                    if counted[j, i] >= _LEAST_INSIDE * points:
                        value = said[j, i] / np.sqrt(counted[j, i])
                        if value > best:
                            best = value
                            found[view, roll, k, 0], found[view, roll, k, 1] = 2 * i - BEYOND, 2 * j - BEYOND
            scores[view, roll, k] = best
