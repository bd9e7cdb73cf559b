"""Pass 4: blend the lists front to back (Eq 3), tile by tile, any number of channels."""

# mypy: allow-untyped-defs, allow-untyped-calls, disable-error-code="assignment"
import numpy as np
from numba import prange

from engine.numerics.jit import parallel_kernel
from engine.raster.lane_memory import fetch_add, load, store
from engine.raster.lanes import fma, spread
from engine.raster.projection import RECORD
from engine.raster.settings import TILE
from engine.raster.tiles import (
    BATCH,
    FIELD,
    FIELDS,
    GRID_X,
    GRID_Y,
    STAGE_ROW,
    STATE,
    blend,
    end_by_impact,
    lay_grid,
    living_blocks,
    log2_alpha,
    open_tile,
    stage_batch,
)

__all__ = ["blend_tiles", "forward_scratch"]

_KERNEL_VERSION = 2

_f = np.float32
_i = np.int32


def forward_scratch(channels: int) -> int:
    """Floats of scratch a worker needs."""
    return FIELDS + channels * FIELD + (BATCH + 1) * STAGE_ROW


@parallel_kernel
def blend_tiles(
    records,
    discs,
    colors,
    channel_tuple,
    ids,
    starts,
    width,
    height,
    tiles_x,
    limits,
    background,
    impact,
    image,
    alpha,
    scratch,
    items,
    counter,
    evaluated,
):
    """Image and accumulated alpha.

    Parameters
    ----------
    records, colors : flat, `RECORD` and C numbers a Gaussian
    discs : flat, `RECORD` numbers a disc (2DGS), or None for Gaussians
    channel_tuple : tuple of length C: the number of channels is part of the compiled type
    ids, starts : the tiles' lists
    limits : float32 (log2 of the smallest alpha, largest alpha, transmittance that ends a pixel, tau of Eq 8)
    background : (C,)
    impact : (N,) W^freq of Eq 8, or None
    counter : (1,) int64, the queue of tiles
    evaluated : (tiles,) int64 out, (Gaussian, block) items blended: 16 pixel fragments each
    """
    channels = len(channel_tuple)
    log2_skip, clamp, stop, threshold = limits[0], limits[1], limits[2], limits[3]
    tiles = starts.shape[0] - 1
    stage = FIELDS + channels * FIELD
    counter[0] = 0
    for worker in prange(scratch.shape[0]):
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
                    item = list_[t]
                    block = item & _i(15)
                    place = np.int64(block) * 16
                    from_ = stage + np.int64(item >> _i(4)) * STAGE_ROW
                    dx = load(own, GRID_X + place) - own[from_]
                    dy = load(own, GRID_Y + place) - own[from_ + 1]
                    q = log2_alpha(own, from_, dx, dy, discs)
                    a, w, after = blend(q, load(own, STATE + place), log2_skip, clamp, stop)
                    for channel in range(channels):
                        field = FIELDS + channel * FIELD + place
                        store(own, field, fma(w, own[from_ + RECORD + channel], load(own, field)))
                    if impact is not None:
                        value = impact[ids[at + np.int64(item >> _i(4))]]
                        after = end_by_impact(own, place, a, w, after, clamp, value, threshold)
                    store(own, STATE + place, after)
                work += count
                at += size
                alive = living_blocks(own, alive, stop)
            evaluated[tile] = work
            for y in range(y0, min(y0 + TILE, height)):
                for x in range(x0, min(x0 + TILE, width)):
                    p, q_ = x - x0, y - y0
                    place = ((q_ >> 2) * 4 + (p >> 2)) * 16 + (q_ & 3) * 4 + (p & 3)
                    rest = abs(own[STATE + place])
                    pixel = y * width + x
                    alpha[pixel] = _f(1.0) - rest
                    for channel in range(channels):
                        value = own[FIELDS + channel * FIELD + place] + rest * background[channel]
                        image[pixel * channels + channel] = value
