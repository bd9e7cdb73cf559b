"""Pass 4: blend the lists front to back (Eq 3, and Eq 8 on request), tile by tile, any number of channels."""

# mypy: allow-untyped-defs, allow-untyped-calls, disable-error-code="assignment"
import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.raster.lane_memory import entry, fetch_add, load, load_quarters, number, store
from engine.raster.lane_order import zip3
from engine.raster.lanes import fma, magnitude, minimum, minus_magnitude, select, spread
from engine.raster.projection import RECORD
from engine.raster.settings import TILE
from engine.raster.tiles import (
    BATCH,
    FIELD,
    FIELDS,
    STAGE_ROW,
    STATE,
    blend,
    is_inside,
    lay_grid,
    living_blocks,
    open_item,
    open_tile,
    place_of,
    stage_batch,
)

_f = np.float32


def forward_scratch(channels: int) -> int:
    """Floats of scratch a worker needs."""
    return FIELDS + channels * FIELD + (BATCH + 1) * STAGE_ROW


@inlined
def write_tile(own, channels, background, image, alpha, x0, y0, width, height):
    """What has been blended, over the background, to the image."""
    if (channels == 1 or channels == 3) and is_inside(x0, y0, width, height):
        for row in range(TILE):
            at, place = (y0 + row) * width + x0, place_of(0, row)
            rest = magnitude(load_quarters(own, STATE + place))
            store(alpha, at, _f(1.0) - rest)
            first = fma(rest, background[0], load_quarters(own, FIELDS + place))
            if channels == 1:
                store(image, at, first)
            else:
                second = fma(rest, background[1], load_quarters(own, FIELDS + FIELD + place))
                third = fma(rest, background[2], load_quarters(own, FIELDS + 2 * FIELD + place))
                vectors = zip3(first, second, third)
                for part in range(3):
                    store(image, 3 * at + 16 * part, vectors[part])
        return
    for y in range(y0, min(y0 + TILE, height)):
        for x in range(x0, min(x0 + TILE, width)):
            place = place_of(x - x0, y - y0)
            rest = abs(own[STATE + place])
            pixel = y * width + x
            alpha[pixel] = _f(1.0) - rest
            for channel in range(channels):
                value = own[FIELDS + channel * FIELD + place] + rest * background[channel]
                image[pixel * channels + channel] = value


@parallel_kernel
def blend_tiles(lists, channel_tuple, colors, background, image, alpha, evaluated, bench, tau, call):
    """Image and accumulated alpha.

    Parameters
    ----------
    lists : `geometry.Geometry.lists`
    channel_tuple : tuple of length C: the number of channels is part of the compiled type
    colors : flat, C numbers a Gaussian
    background : (C,)
    image, alpha : flat (H, W, C) and (H, W), out
    evaluated : (tiles,) int64 out, (Gaussian, block) items blended: 16 pixel fragments each
    bench : `workspace.Workspace.tile_bench`
    tau : None, or a number: the last channel is W of Eq 8, sums alpha W, and ends a pixel where that reaches tau
    """
    records, discs, ids, starts, width, height, tiles_x, limits = lists
    scratch, items, counter = bench
    channels = len(channel_tuple)
    blended = channels if tau is None else channels - 1
    log2_skip, clamp, stop = limits[0], limits[1], limits[2]
    tiles = starts.shape[0] - 1
    stage = FIELDS + channels * FIELD
    for worker in share_of(scratch.shape[0], call):
        own = scratch[worker]
        list_ = items[worker]
        lay_grid(own)
        while True:
            tile = fetch_add(counter, 0, 1)
            if tile >= tiles:
                break
            row = tile // tiles_x
            x0, y0 = (tile - row * tiles_x) * TILE, row * TILE
            left, top = _f(x0), _f(y0)
            at, end = starts[tile], starts[tile + 1]
            alive = open_tile(own, x0, y0, width, height)
            for place in range(0, channels * FIELD, 16):
                store(own, FIELDS + place, spread(_f(0.0)))
            work = np.int64(0)
            while at < end and alive != 0:
                size = min(BATCH, end - at)
                count = stage_batch(
                    own, stage, list_, records, discs, colors, channels, ids, at, size, end, left, top, alive, log2_skip
                )
                for t in range(count):
                    place, _, from_, _, _, q = open_item(own, stage, entry(list_, t), discs)
                    opacity, w, after = blend(q, load(own, STATE + place), log2_skip, clamp, stop)
                    for channel in range(blended):
                        field = FIELDS + channel * FIELD + place
                        store(own, field, fma(w, number(own, from_ + RECORD + channel), load(own, field)))
                    if tau is not None:
                        field = FIELDS + blended * FIELD + place
                        shown = select(w > _f(0.0), minimum(opacity, clamp), spread(_f(0.0)))
                        total = fma(shown, number(own, from_ + RECORD + blended), load(own, field))
                        store(own, field, total)
                        after = select(total >= tau, minus_magnitude(after), after)
                    store(own, STATE + place, after)
                work += count
                at += size
                alive = living_blocks(own, alive, stop)
            evaluated[tile] = work
            write_tile(own, channels, background, image, alpha, x0, y0, width, height)
