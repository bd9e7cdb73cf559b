"""Kernels of the search over views: which points describe a view, and how well a picture's edges fit every view, roll,
size and place."""

# mypy: allow-untyped-defs

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.kernels.jit import inlined, kernel, parallel_kernel, share_of
from engine.kernels.thread_crew import thread_count
from engine.model import Bool, Float32, Float64, Int64
from engine.pictures.camera.config import CONFIG

SIDE, BINS, ROLLS = CONFIG.edges.side, CONFIG.edges.bins, CONFIG.edges.rolls
BEYOND, LEAST_INSIDE = CONFIG.edges.beyond, CONFIG.edges.least_inside
PAD = 2 * SIDE
"""Pixels of nothing kept around the picture: points of a view may lie so far outside."""
RUN = 8
"""Jobs that share their memory."""


def look_again(
    maps: Float32,
    inside: Float32,
    places: Float32,
    directions: Float32,
    views: Int64,
    starts: Float64,
    scores: Float32,
    poses: Float64,
) -> None:
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
    room = np.empty((thread_count(), 3, directions.shape[1]), dtype=np.int64)
    sums = np.empty((thread_count(), 2, 5, 5))
    _look_again(maps, inside, places, directions, views, starts, room, sums, scores, poses)


@inlined
def _sum_around(maps, inside, bins, rows, columns, said, counted):
    """What the picture says to points at 25 places up to two pixels from theirs, and how many lie inside (5, 5)."""
    said[:] = 0.0
    counted[:] = 0.0
    for p in range(len(bins)):  # farther out nothing is said: the picture is padded by more
        if 2 <= rows[p] < maps.shape[1] - 2 and 2 <= columns[p] < maps.shape[2] - 2:
            top, left = rows[p] - 2, columns[p] - 2
            one = maps[bins[p]]
            for j in range(5):
                for i in range(5):
                    said[j, i] += one[top + j, left + i]
                    counted[j, i] += inside[top + j, left + i]


@parallel_kernel
def _look_again(maps, inside, places, directions, views, starts, room, sums, scores, poses, call):
    points = directions.shape[1]
    columns, rows, bins = room[call[0], 0], room[call[0], 1], room[call[0], 2]
    said, counted = sums[call[0], 0], sums[call[0], 1]
    for f in share_of(views.shape[0], call):
        view = views[f]
        best = np.float32(-1e9)
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
                _sum_around(maps, inside, bins, rows, columns, said, counted)
                for j in range(5):
                    for i in range(5):
                        if counted[j, i] >= LEAST_INSIDE * points and said[j, i] / np.sqrt(counted[j, i]) > best:
                            best = said[j, i] / np.sqrt(counted[j, i])
                            poses[f, 0], poses[f, 1] = angle, radius
                            poses[f, 2], poses[f, 3] = starts[f, 2] + (i - 2), starts[f, 3] + (j - 2)
        scores[f] = best


def score_views(
    maps: Float32,
    places: Float32,
    directions: Float32,
    jobs: Int64,
    radii: npt.NDArray[Any],
    size: npt.NDArray[Any],
    scores: Float32,
    found: npt.NDArray[Any],
) -> None:
    """Best place of each job: a view, a roll and a size.

    Parameters
    ----------
    maps : (BINS, step, step, h, w) float32
        Responses, every step-th row and column together, padded by PAD pixels: places lie that far apart.
    places, directions : (V, P, 2), (V, P) float32
        Of the views' points, from their middle in units of their spread; radians.
    jobs : (J, 3) int64
        View, roll in steps of a whole turn / ROLLS, and which of the sizes.
    radii : (S,) float32, pixels
    size : (2,) height and width of the picture
    scores : (J,) out
        Sum of responses over the root of how many points lie in the picture.
    found : (J, 2) out
        x, y of the middle there, pixels.
    """
    step, threads = maps.shape[1], thread_count()
    rows, columns = ((int(side) + 2 * BEYOND) // step for side in size)
    room = np.empty((threads, rows, columns), np.float32), np.empty((threads, rows + 1, columns + 1), np.int32)
    roots = np.sqrt(np.arange(directions.shape[1] + 1).astype(np.float32))
    _score_views(maps, places, directions, jobs, radii, size, roots, room, scores, found)


@parallel_kernel
def _score_views(maps, places, directions, jobs, radii, size, roots, room, scores, found, call):
    points, step = directions.shape[1], maps.shape[1]
    height, width = size[0], size[1]
    said, counted = room[0][call[0]], room[1][call[0]]
    rows, columns = said.shape
    for run in share_of((len(jobs) + RUN - 1) // RUN, call):
        for job in range(run * RUN, min(run * RUN + RUN, len(jobs))):
            view, radius = jobs[job, 0], radii[jobs[job, 2]]
            angle = 2.0 * np.pi * jobs[job, 1] / ROLLS
            c, s = np.cos(angle), np.sin(angle)
            said[:] = np.float32(0.0)
            counted[:] = 0
            for p in range(points):
                x, y = places[view, p, 0] * radius, places[view, p, 1] * radius
                column = int(np.floor(c * x - s * y + 0.5)) - BEYOND
                row = int(np.floor(s * x + c * y + 0.5)) - BEYOND
                # of the places tried, those that put this point into the picture
                left, right = max(0, -(column // step)), min(columns, -((column - width) // step))
                top, bottom = max(0, -(row // step)), min(rows, -((row - height) // step))
                if left >= right or top >= bottom:
                    continue
                bin = int(np.floor((directions[view, p] + angle) * BINS / np.pi + 0.5)) % BINS
                one = maps[bin, (row + PAD) % step, (column + PAD) % step]
                above, before = (row + PAD) // step, (column + PAD) // step
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
                    if inside >= LEAST_INSIDE * points and said[j, i] > best * roots[inside]:
                        best = said[j, i] / roots[inside]
                        found[job, 0], found[job, 1] = step * i - BEYOND, step * j - BEYOND
            scores[job] = best


def spread_out(strength: Float32, order: Int64, count: int, free: Bool, reach: int) -> Int64:
    """(P, 2) x, y of at most `count` pixels of `strength` (h, w), in `order` of it, while it is above 0: those that are
    `free` (h, w) and more than `reach` pixels, along an axis, from those before. `free` is used up."""
    chosen = np.empty((count, 2), dtype=np.int64)
    return chosen[: _spread_out(strength, order, free, reach, chosen)]


@kernel
def _spread_out(strength, order, free, reach, chosen):
    """`spread_out`, to `chosen`; returns how many."""
    height, width = strength.shape
    taken = 0
    for index in order:
        row, column = index // width, index % width
        if taken == len(chosen) or strength[row, column] <= 0:
            break
        if free[row, column]:
            chosen[taken, 0], chosen[taken, 1] = column, row
            taken += 1
            for j in range(max(0, row - reach), min(height, row + reach + 1)):
                for i in range(max(0, column - reach), min(width, column + reach + 1)):
                    free[j, i] = False
    return taken
