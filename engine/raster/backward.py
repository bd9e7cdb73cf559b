"""Sums per (tile, Gaussian) pair: the colour gradient, and the blending weights themselves.

The image is linear in the colours, dL/dcolor_i = sum over pixels of w_i * cotangent. The passes walk the
tiles as `forward` does and take the same decisions. Each batch keeps one accumulator row (16 lanes) per
Gaussian and quantity; at the end of the batch 16 rows at a time collapse into one vector by a transposed
sum. Every pair has its own place in the output (16 bytes for three channels), so nothing is shared
between threads, and `gather_sums` adds a Gaussian's pairs in the order of tiles: the result has the same bits
whatever the number of threads. The gather is a sixth of the pass (real scene, 524k Gaussians, 0.9 M pairs:
4.7 of 28 ms on one core).
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.raster.lane_memory import entry, fetch_add, load, prefetch, store, sum_rows
from engine.raster.lanes import fma, maximum, spread
from engine.raster.settings import TILE
from engine.raster.tiles import (
    BATCH,
    FIELD,
    FIELDS,
    STAGE_ROW,
    STATE,
    blend,
    fill_field,
    lay_grid,
    living_blocks,
    open_item,
    open_tile,
    stage_batch,
)

_f = np.float32
_AHEAD = 32  # pairs: about the time that a line takes from memory
_SIXTEEN = (0,) * 16

WEIGHT_SUMS = 2
"""Sums of `pair_sums` without a cotangent: w and w^2."""


def pair_width(channels: int) -> int:
    """Numbers a pair takes in the output, a divisor of 16."""
    return 1 if channels == 1 else 4


def backward_scratch(fields: int, width: int) -> int:
    """Floats of scratch a worker needs."""
    return FIELDS + fields * FIELD + (BATCH + 1) * STAGE_ROW + BATCH * width * 16 + 16


@inlined
def clear_rows(own, rows, count):
    """Zero accumulator rows."""
    for row in range(count):
        store(own, rows + row * 16, spread(_f(0.0)))


@inlined
def write_sums(own, rows, count, spare, out, to):
    """out[to : to + count] = sums of the first `count` accumulator rows."""
    whole = count // 16
    for group in range(whole):
        store(out, to + group * 16, sum_rows(own, rows + group * 256, _SIXTEEN))
    if whole * 16 < count:  # the next numbers belong to another tile, maybe another thread's
        store(own, spare, sum_rows(own, rows + whole * 256, _SIXTEEN))
        for k in range(whole * 16, count):
            out[to + k] = own[spare + k - whole * 16]


@parallel_kernel
def pair_sums(lists, channel_tuple, pair_tuple, cotangent, out, bench, call):
    """Per pair and channel: sum over the tile's pixels of w * cotangent; where that is None, of w and of w^2.

    `cotangent` is flat (H, W, C), C the length of `channel_tuple`; `out` is flat (pairs, length of
    `pair_tuple`). The rest as in `forward.blend_tiles`.
    """
    records, discs, ids, starts, width, height, tiles_x, limits = lists
    scratch, items, counter = bench
    channels, pair = len(channel_tuple), len(pair_tuple)
    log2_skip, clamp, stop = limits[0], limits[1], limits[2]
    tiles = starts.shape[0] - 1
    stage = FIELDS + channels * FIELD
    rows = stage + (BATCH + 1) * STAGE_ROW
    spare, nothing = rows + BATCH * pair * 16, spread(_f(0.0))
    for worker in share_of(scratch.shape[0], call):
        own = scratch[worker]
        list_ = items[worker]
        lay_grid(own)
        clear_rows(own, rows, BATCH * pair)
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
            if cotangent is not None:
                for channel in range(channels):
                    fill_field(own, FIELDS + channel * FIELD, cotangent, channels, channel, x0, y0, width, height)
            while at < end and alive != 0:
                size = min(BATCH, end - at)
                count = stage_batch(
                    own, stage, list_, records, discs, out, 0, ids, at, size, end, left, top, alive, log2_skip
                )
                for t in range(count):
                    place, j, _, _, _, q = open_item(own, stage, entry(list_, t), discs)
                    _, w, after = blend(q, load(own, STATE + place), log2_skip, clamp, stop)
                    to = rows + j * pair * 16
                    if cotangent is None:
                        store(own, to, load(own, to) + w)
                        # As a maximum the square is rounded before it is added: fused, it would have other last digits.
                        store(own, to + 16, load(own, to + 16) + maximum(w * w, nothing))
                    else:
                        for channel in range(channels):
                            seen = load(own, FIELDS + channel * FIELD + place)
                            store(own, to + channel * 16, fma(w, seen, load(own, to + channel * 16)))
                    store(own, STATE + place, after)
                write_sums(own, rows, size * pair, spare, out, at * pair)
                clear_rows(own, rows, size * pair)
                at += size
                alive = living_blocks(own, alive, stop)
            for k in range(at * pair, end * pair):  # behind the pixels' ends
                out[k] = _f(0.0)


@parallel_kernel
def gather_sums(values, pair_tuple, firsts, slots, shares, out, call):
    """out[i] (N, C) = sum of the pairs of Gaussian i, in the order of tiles; `values` is flat (pairs, pair
    width)."""
    n, channels = out.shape
    pair = len(pair_tuple)
    total = np.int64(firsts[n])
    share = (n + shares - 1) // shares
    for part in share_of(shares, call):
        for i in range(part * share, min(n, (part + 1) * share)):
            for channel in range(channels):
                out[i, channel] = _f(0.0)
            for s in range(np.int64(firsts[i]), np.int64(firsts[i + 1])):
                if s + _AHEAD < total:
                    prefetch(values, np.int64(slots[s + _AHEAD]) * pair)
                at = np.int64(slots[s]) * pair
                for channel in range(channels):
                    out[i, channel] += values[at + channel]
