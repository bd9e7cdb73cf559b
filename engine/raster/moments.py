"""Sums per (tile, Gaussian) pair for the gradients of everything.

In addition to the colour sums, a pair collects the moments of s = alpha dL/dalpha over its pixels: s, s dx, s dy,
s dx^2, s dx dy, s dy^2, with (dx, dy) from the centre. All parameters of the projected Gaussian follow from
these six, once per Gaussian, in `parameter_gradients`.

The walk is front to back like the forward one, so it needs no stored lists: with D = cotangent . (what of the
final pixel still lies behind), dL/dalpha = T (cotangent . color) - D / (1 - alpha).
"""

# mypy: allow-untyped-defs, allow-untyped-calls, disable-error-code="assignment"
import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.raster.backward import clear_rows
from engine.raster.lane_memory import entry, fetch_add, load, load_quarters, number, store, store_quarters, sum_rows
from engine.raster.lanes import fma, minimum, select, spread
from engine.raster.projection import RECORD
from engine.raster.settings import TILE
from engine.raster.tiles import (
    BATCH,
    FIELD,
    FIELDS,
    STAGE_ROW,
    STATE,
    blend,
    fill_field,
    is_inside,
    lay_grid,
    living_blocks,
    open_item,
    open_tile,
    pixels_of_row,
    place_of,
    stage_batch,
)

MOMENTS = 6
"""s, s dx, s dy, s dx^2, s dx dy, s dy^2."""

PAIR_NUMBERS = 16
"""Numbers a pair takes in the output: the moments, the colour sums, zeros."""

_f = np.float32


def moments_scratch(channels: int) -> int:
    """Floats of scratch a worker needs."""
    fields = channels + 2
    return FIELDS + fields * FIELD + (BATCH + 1) * STAGE_ROW + BATCH * (MOMENTS + channels) * 16


@inlined
def fill_behind(own, behind, first, channels, image, alpha, cotangent_alpha, x0, y0, width, height):
    """Field of D = cotangent . image + cotangent_alpha alpha; the cotangents' fields begin at `first`."""
    if is_inside(x0, y0, width, height):
        for row in range(TILE):
            at, place = (y0 + row) * width + x0, place_of(0, row)
            lanes = load(cotangent_alpha, at) * load(alpha, at)
            for channel in range(channels):
                seen = pixels_of_row(image, at * channels, channel, channels)
                lanes = fma(load_quarters(own, first + channel * FIELD + place), seen, lanes)
            store_quarters(own, behind + place, lanes)
        return
    for place in range(FIELD):
        own[behind + place] = _f(0.0)
    for y in range(y0, min(y0 + TILE, height)):
        for x in range(x0, min(x0 + TILE, width)):
            place = place_of(x - x0, y - y0)
            pixel = y * width + x
            total = cotangent_alpha[pixel] * alpha[pixel]
            for channel in range(channels):
                total += own[first + channel * FIELD + place] * image[pixel * channels + channel]
            own[behind + place] = total


@parallel_kernel
def pair_moments(lists, channel_tuple, row_tuple, colors, image, alpha, cotangent, cotangent_alpha, out, bench, call):
    """Per pair: six moments and C colour sums, in `PAIR_NUMBERS` numbers of the flat `out`.

    `image` and `alpha` are what `forward.blend_tiles` returned, `cotangent` and `cotangent_alpha` their
    cotangents, all flat; `row_tuple` has length MOMENTS + C. The rest as there; discs are not differentiated.
    """
    records, _, ids, starts, width, height, tiles_x, limits = lists
    scratch, items, counter = bench
    channels, rows_each = len(channel_tuple), len(row_tuple)
    log2_skip, clamp, stop = limits[0], limits[1], limits[2]
    tiles = starts.shape[0] - 1
    alpha_field = FIELDS + channels * FIELD
    behind_field = alpha_field + FIELD
    stage = behind_field + FIELD
    rows = stage + (BATCH + 1) * STAGE_ROW
    for worker in share_of(scratch.shape[0], call):
        own = scratch[worker]
        list_ = items[worker]
        lay_grid(own)
        clear_rows(own, rows, BATCH * rows_each)
        zero, one, clamp_lanes = spread(_f(0.0)), spread(_f(1.0)), spread(clamp)
        while True:
            tile = fetch_add(counter, 0, 1)
            if tile >= tiles:
                break
            at, end = starts[tile], starts[tile + 1]
            if at == end:
                continue
            row = tile // tiles_x
            x0, y0 = (tile - row * tiles_x) * TILE, row * TILE
            left, top = _f(x0), _f(y0)
            alive = open_tile(own, x0, y0, width, height)
            for channel in range(channels):
                fill_field(own, FIELDS + channel * FIELD, cotangent, channels, channel, x0, y0, width, height)
            fill_field(own, alpha_field, cotangent_alpha, 1, 0, x0, y0, width, height)
            fill_behind(own, behind_field, FIELDS, channels, image, alpha, cotangent_alpha, x0, y0, width, height)
            while at < end and alive != 0:
                size = min(BATCH, end - at)
                count = stage_batch(
                    own, stage, list_, records, None, colors, channels, ids, at, size, end, left, top, alive, log2_skip
                )
                for t in range(count):
                    place, j, from_, dx, dy, q = open_item(own, stage, entry(list_, t), None)
                    raw, w, after = blend(q, load(own, STATE + place), log2_skip, clamp, stop)
                    to = rows + j * rows_each * 16
                    u = load(own, alpha_field + place)  # dL/dw: cotangent . color
                    for channel in range(channels):
                        g = load(own, FIELDS + channel * FIELD + place)
                        u = fma(g, number(own, from_ + RECORD + channel), u)
                        sums = to + (MOMENTS + channel) * 16
                        store(own, sums, fma(w, g, load(own, sums)))
                    wu = w * u
                    rest = load(own, behind_field + place) - wu
                    store(own, behind_field + place, rest)
                    a = minimum(raw, clamp_lanes)
                    s = wu - rest * a / (one - a)
                    # Not blended, or held by the clamp: alpha does not move with the parameters.
                    s = select((w > zero) & (raw <= clamp_lanes), s, zero)
                    sx, sy = s * dx, s * dy
                    store(own, to, load(own, to) + s)
                    store(own, to + 16, load(own, to + 16) + sx)
                    store(own, to + 32, load(own, to + 32) + sy)
                    store(own, to + 48, fma(sx, dx, load(own, to + 48)))
                    store(own, to + 64, fma(sx, dy, load(own, to + 64)))
                    store(own, to + 80, fma(sy, dy, load(own, to + 80)))
                    store(own, STATE + place, after)
                for j in range(size):
                    store(out, (at + j) * PAIR_NUMBERS, sum_rows(own, rows + j * rows_each * 16, row_tuple))
                clear_rows(own, rows, size * rows_each)
                at += size
                alive = living_blocks(own, alive, stop)
            for k in range(at, end):  # behind the pixels' ends
                store(out, k * PAIR_NUMBERS, zero)
