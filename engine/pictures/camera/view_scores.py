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
from engine.raster.lane_ir import LANES
from engine.raster.lane_memory import load, store
from engine.raster.lanes import spread

SIDE, BINS, ROLLS = CONFIG.edges.side, CONFIG.edges.bins, CONFIG.edges.rolls
BEYOND, LEAST_INSIDE = CONFIG.edges.beyond, CONFIG.edges.least_inside
PAD = 2 * SIDE
"""Pixels of nothing kept around the picture: points of a view may lie so far outside."""
STEP = CONFIG.edges.step
AROUND = 5
"""Places in a row, and rows of them, that are looked at around a find."""


def look_again(
    maps: Float32,
    size: npt.NDArray[Any],
    places: Float32,
    directions: Float32,
    views: Int64,
    starts: Float64,
    steps: int,
    finds: Float64,
) -> None:
    """The best pose near each of F: place within 2 pixels, so many steps of 3.75 degrees of roll, and of 5.5 % of size.

    Parameters
    ----------
    maps : (BINS, h, w) float32
        Responses, padded by PAD pixels.
    size : (2,) height and width of the picture
    views : (F,) int64
    starts : (F, 4)
        Roll, radians; size, pixels; x, y of the middle, pixels.
    finds : (F, 5) out
        As `starts`, and the score.
    """
    threads, points = thread_count(), directions.shape[1]
    room = np.empty((threads, 3, points), np.int64), np.empty((threads, AROUND * LANES), np.float32)
    counted = np.empty((threads, AROUND, AROUND), np.int64)
    roots = np.sqrt(np.arange(points + 1).astype(np.float32))
    shape = *maps.shape[1:], *(int(side) for side in size)
    _look_again(maps.reshape(-1), shape, places, directions, views, starts, steps, (*room, counted), roots, finds)


@inlined
def _sum_around(maps, shape, bins, rows, columns, said, counted):
    """What the picture says to points at 25 places up to two pixels from theirs, and how many lie inside (5, 5)."""
    tall, wide, height, width = shape
    counted[:] = 0
    one = two = three = four = five = spread(np.float32(0.0))
    whole = 0
    for p in range(len(bins)):  # farther out nothing is said: the picture is padded by more
        row, column = rows[p] - 2, columns[p] - 2
        if not (0 <= row <= tall - AROUND and 0 <= column <= wide - LANES):
            continue
        at = (bins[p] * tall + row) * wide + column
        one += load(maps, at)
        two += load(maps, at + wide)
        three += load(maps, at + 2 * wide)
        four += load(maps, at + 3 * wide)
        five += load(maps, at + 4 * wide)
        row, column = row - PAD, column - PAD
        if 0 <= row <= height - AROUND and 0 <= column <= width - AROUND:
            whole += 1
            continue
        for j in range(max(0, -row), min(AROUND, height - row)):
            for i in range(max(0, -column), min(AROUND, width - column)):
                counted[j, i] += 1
    for j, sums in enumerate((one, two, three, four, five)):
        store(said, j * LANES, sums)
    return whole


@parallel_kernel
def _look_again(maps, shape, places, directions, views, starts, steps, room, roots, finds, call):
    points = directions.shape[1]
    columns, rows, bins = room[0][call[0], 0], room[0][call[0], 1], room[0][call[0], 2]
    said, counted = room[1][call[0]], room[2][call[0]]
    for f in share_of(views.shape[0], call):
        view = views[f]
        best = np.float32(-1e9)
        for turn in range(-steps, steps + 1):
            angle = starts[f, 0] + turn * (np.pi / ROLLS / 2.0)
            c, s = np.cos(angle), np.sin(angle)
            for p in range(points):
                bins[p] = int(np.floor((directions[view, p] + angle) * BINS / np.pi + 0.5)) % BINS
            for grow in range(-steps, steps + 1):
                radius = starts[f, 1] * (1.0 + 0.055 * grow)
                for p in range(points):
                    x, y = places[view, p, 0] * radius, places[view, p, 1] * radius
                    columns[p] = int(np.floor(c * x - s * y + 0.5)) + PAD + int(starts[f, 2])
                    rows[p] = int(np.floor(s * x + c * y + 0.5)) + PAD + int(starts[f, 3])
                whole = _sum_around(maps, shape, bins, rows, columns, said, counted)
                for j in range(AROUND):
                    for i in range(AROUND):
                        inside, total = whole + counted[j, i], said[j * LANES + i]
                        if inside >= LEAST_INSIDE * points and total > best * roots[inside]:
                            best = total / roots[inside]
                            finds[f, 0], finds[f, 1] = angle, radius
                            finds[f, 2], finds[f, 3] = starts[f, 2] + (i - 2), starts[f, 3] + (j - 2)
        finds[f, 4] = best


def folded(responses: Float32) -> npt.NDArray[np.int16]:
    """(BINS, STEP, STEP, rows, columns) of responses (BINS, h, w), every STEP-th row and column together, and so many
    columns of nothing that along all rows, one after the other, no place beside the picture lies in it. In units in
    which a sum over a view's points is no more than 16 bits hold."""
    bins, height, width = responses.shape
    rows, columns = -(-height // STEP), -(-width // STEP)
    largest = CONFIG.edges.points * max(float(np.abs(responses).max()), 1e-6)
    grid = np.zeros((bins, rows * STEP, columns * STEP), dtype=np.int16)
    grid[:, :height, :width] = np.rint(responses * np.float32(32_000.0 / largest))
    grid = grid.reshape(bins, rows, STEP, columns, STEP).transpose(0, 2, 4, 1, 3)
    return np.pad(grid, [(0, 0)] * 4 + [(0, (width + 2 * BEYOND) // STEP)])


def score_views(
    maps: npt.NDArray[np.int16],
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
    maps : (BINS, STEP, STEP, h, w) int16
        `folded` responses: places lie STEP pixels apart.
    places, directions : (V, P, 2), (V, P) float32
        Of the views' points, from their middle in units of their spread; radians.
    jobs : (J, 3) int64
        View, roll in steps of a whole turn / ROLLS, and which of the sizes.
    radii : (S,) float32, pixels
    size : (2,) height and width of the picture
    scores : (J,) out
        Sum of responses, in units of the maps, over the root of how many points lie in the picture.
    found : (J, 2) out
        x, y of the middle there, pixels.
    """
    threads, (rows, columns) = thread_count(), ((int(side) + 2 * BEYOND) // STEP for side in size)
    wide = maps.shape[4]
    sums = np.empty((threads, rows * wide), np.int16), np.empty((threads, rows + 1, columns), np.int16)
    room = *sums, np.empty((threads, columns), np.float32)
    flat = maps.reshape(*maps.shape[:3], -1)
    _score_views(flat, wide, places, directions, jobs, radii, size, room, scores, found)


@inlined
def _best_place(said, counted, wide, least, squared, found):
    """The largest sum over the root of how many points lie inside, and where: x and y to `found`, in steps."""
    rows, columns = counted.shape[0] - 1, counted.shape[1]
    lowest = np.float32(-np.inf)
    best = lowest
    found[:] = 0
    for j in range(rows):
        inside, sums = counted[j], said[j * wide : j * wide + columns]
        below = counted[j + 1]
        better = 0
        for i in range(columns):
            below[i] += inside[i]
            total = np.float32(sums[i])
            squared[i] = total * abs(total) / max(np.float32(inside[i]), np.float32(1.0))
            if inside[i] < least:
                squared[i] = lowest
            better += squared[i] > best
        if better > 0:
            for i in range(columns):
                if squared[i] > best:
                    best = squared[i]
                    found[0], found[1] = i, j
    return np.sqrt(best) if best > 0.0 else -np.sqrt(-best)


@parallel_kernel
def _score_views(maps, wide, places, directions, jobs, radii, size, room, scores, found, call):
    points, height, width = directions.shape[1], size[0], size[1]
    said, counted, squared = room[0][call[0]], room[1][call[0]], room[2][call[0]]
    rows, columns = counted.shape[0] - 1, counted.shape[1]
    for job in share_of(len(jobs), call):
        view, radius = jobs[job, 0], radii[jobs[job, 2]]
        angle = 2.0 * np.pi * jobs[job, 1] / ROLLS
        c, s = np.cos(angle), np.sin(angle)
        said[:] = 0
        counted[:] = 0
        for p in range(points):
            x, y = places[view, p, 0] * radius, places[view, p, 1] * radius
            column = int(np.floor(c * x - s * y + 0.5)) - BEYOND
            row = int(np.floor(s * x + c * y + 0.5)) - BEYOND
            # of the places tried, those that put this point into the picture
            left, right = max(0, -(column // STEP)), min(columns, -((column - width) // STEP))
            top, bottom = max(0, -(row // STEP)), min(rows, -((row - height) // STEP))
            if left >= right or top >= bottom:
                continue
            bin = int(np.floor((directions[view, p] + angle) * BINS / np.pi + 0.5)) % BINS
            first, last = top * wide + left, (bottom - 1) * wide + right
            start = (row // STEP) * wide + column // STEP
            sums, terms = said[first:last], maps[bin, row % STEP, column % STEP, start + first : start + last]
            for i in range(len(sums)):  # from 0: what may be negative is not vectorised
                sums[i] += terms[i]
            enters, leaves = counted[top, left:right], counted[bottom, left:right]
            for i in range(len(enters)):
                enters[i] += 1
                leaves[i] -= 1
        scores[job] = _best_place(said, counted, wide, LEAST_INSIDE * points, squared, found[job])
        found[job, 0], found[job, 1] = STEP * found[job, 0] - BEYOND, STEP * found[job, 1] - BEYOND


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
