"""Passes 2 and 3: visible Gaussians front to back, and per tile the list of those that touch it, in that order.

Pass 2 is a stable radix sort. Depths are positive, so their bits sort like the numbers. Chunks arrive in model order
and every pass is stable: equal depths keep the model's order, whatever the number of threads. A key and what it belongs
to move as one number, so that a bucket is one stream of writes.

Pass 3: a Gaussian enters exactly the tiles whose pixel centres its ellipse {alpha >= alpha_skip} can reach: those that
pass 1 has stored as bits where it is small, else per row of tiles the ellipse's span in x. One walk over the depth
order notes the pairs and counts them per tile, a second pass puts them in place. Both split the order into contiguous
shares, so lists come out in depth order whatever the number of shares. A tile mask leaves tiles out altogether.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math

# mypy: allow-untyped-defs, allow-untyped-calls
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from engine.kernels.jit import inlined, kernel, parallel_kernel, share_of
from engine.kernels.thread_crew import thread_count
from engine.model import Int32, Int64
from engine.raster.lane_memory import lowest_bit, prefetch
from engine.raster.projection import COVER, RECORD
from engine.raster.settings import TILE

_f = np.float32
_AHEAD = 16  # Gaussians: about the time that a line takes from memory
_PER_TILE = _f(1.0 / TILE)


@inlined
def _row_span(records, o, hx, hy, row, log2_skip):
    """Interval of x in which the ellipse meets the pixel centres of a row of tiles; low > high where it
    does not."""
    u, v, a, b, c = records[o], records[o + 1], records[o + 2], records[o + 3], records[o + 4]
    below = records[o + 5] - log2_skip  # a dx^2 + b dx dy + c dy^2 + below >= 0 inside
    first = max(_f(row * TILE) + _f(0.5) - v, -hy)
    last = min(_f(row * TILE) + _f(TILE - 0.5) - v, hy)
    if first > last:
        return _f(1.0), _f(-1.0)
    peak = records[o + 7] * hx  # dy at which the ellipse reaches its largest dx; at -peak its smallest
    dy = min(max(peak, first), last)
    inside = (b * dy) * (b * dy) - _f(4.0) * a * (c * dy * dy + below)
    high = min((-(b * dy) - math.sqrt(max(inside, _f(0.0)))) / (_f(2.0) * a), hx)
    dy = min(max(-peak, first), last)
    inside = (b * dy) * (b * dy) - _f(4.0) * a * (c * dy * dy + below)
    low = max((-(b * dy) + math.sqrt(max(inside, _f(0.0)))) / (_f(2.0) * a), -hx)
    return u + low, u + high


@inlined
def _columns(records, extents, rects, i, row, log2_skip):
    """First and last tile column that Gaussian i touches in a row of tiles."""
    first, last = np.int64(rects[4 * i]), np.int64(rects[4 * i + 1])
    if first == last or rects[4 * i + 2] == rects[4 * i + 3]:  # one column or one row: the rectangle is exact
        return first, last
    low, high = _row_span(records, i * RECORD, extents[2 * i], extents[2 * i + 1], row, log2_skip)
    if low > high:
        return np.int64(0), np.int64(-1)
    first = max(first, np.int64(math.floor((low - _f(0.5)) * _PER_TILE)))
    last = min(last, np.int64(math.floor((high - _f(0.5)) * _PER_TILE)))
    return first, last


@inlined
def _note(histogram, pairs, count, tile, i):
    """One more pair; returns how many there are, noted or not."""
    tiles, owners = pairs
    histogram[tile] += 1
    if count < tiles.shape[0]:
        tiles[count] = tile
        owners[count] = i
    return count + 1


@parallel_kernel
def list_pairs(order, visible, records, bounds, tiles_x, log2_skip, histograms, sizes, tiles, owners, counts, call):
    """Walk the Gaussians front to back and note every (tile, Gaussian) pair.

    `bounds` is what `projection.project` wrote. Each share of the order fills its own row of `tiles` and `owners`
    (shares, capacity) and counts its pairs per tile in `histograms` (shares, tiles) and altogether in `counts`
    (shares,); `sizes` (N,) gets the tiles of every Gaussian. Where a row is too short the walk continues counting: the
    caller makes longer rows and calls again.
    """
    extents, rects, covers = bounds
    shares = histograms.shape[0]
    share = (visible + shares - 1) // shares
    for part in share_of(shares, call):
        own = histograms[part]
        pairs = (tiles[part], owners[part])
        for tile in range(own.shape[0]):
            own[tile] = 0
        count = np.int64(0)
        end = min(visible, (part + 1) * share)
        for k in range(part * share, end):
            if k + _AHEAD < end:
                ahead = np.int64(order[k + _AHEAD])
                prefetch(rects, 4 * ahead)
                prefetch(covers, ahead)
            i = np.int64(order[k])
            before = count
            cover = np.int32(covers[i])
            corner = np.int64(rects[4 * i + 2]) * tiles_x + np.int64(rects[4 * i])
            if cover == 0:
                for row in range(np.int64(rects[4 * i + 2]), np.int64(rects[4 * i + 3]) + 1):
                    first, last = _columns(records, extents, rects, i, row, log2_skip)
                    for column in range(first, last + 1):
                        count = _note(own, pairs, count, row * tiles_x + column, i)
            while cover != 0:
                bit = np.int64(lowest_bit(cover))
                cover &= cover - np.int32(1)
                count = _note(own, pairs, count, corner + (bit // COVER) * tiles_x + bit % COVER, i)
            sizes[i] = count - before
        counts[part] = count


@parallel_kernel
def place_pairs(tiles, owners, counts, histograms, ids, firsts, slots, call):
    """Write the lists from the rows of `list_pairs`.

    `histograms` (shares, tiles) holds where each share writes next in each tile. `ids` (pairs,) are the
    lists, tile after tile. ``slots[firsts[i]:firsts[i + 1]]`` are the places of Gaussian i in `ids`; left
    out if `slots` is empty.
    """
    keep = slots.shape[0] > 0
    for part in share_of(counts.shape[0], call):
        own = histograms[part]
        own_tiles, own_owners = tiles[part], owners[part]
        previous, run = np.int64(-1), np.int64(0)
        for k in range(counts[part]):
            tile, i = own_tiles[k], np.int64(own_owners[k])
            to = own[tile]
            own[tile] = to + 1
            ids[to] = i
            if keep:
                if k + _AHEAD < counts[part]:
                    prefetch(firsts, np.int64(own_owners[k + _AHEAD]))
                run = (run + 1) * np.int64(i == previous)  # a Gaussian's pairs follow each other
                previous = i
                slots[np.int64(firsts[i]) + run] = to


@kernel
def list_starts(histograms, starts):
    """Turn counts per share and tile into places to write; `starts` (tiles + 1,) gets where each list
    begins."""
    total = 0
    for tile in range(histograms.shape[1]):
        starts[tile] = total
        for part in range(histograms.shape[0]):
            size = histograms[part, tile]
            histograms[part, tile] = total
            total += size
    starts[histograms.shape[1]] = total
    return total


_BITS = 11
BUCKETS = 1 << _BITS
_WORTH_A_THREAD = 1 << 15
"""Gaussians below which a second thread takes longer to be called than to help."""
_LOW = np.uint64(BUCKETS - 1)
_HALF = np.uint64(32)
_INDEX = np.uint64(0xFFFFFFFF)


def workers_for(n: int) -> int:
    """How many threads sort n Gaussians best."""
    return min(thread_count(), max(1, n // _WORTH_A_THREAD))


def sort_by_depth(
    depth_bits: npt.NDArray[np.uint32],
    index: Int32,
    counts: Int64,
    chunk: int,
    keys: Sequence[npt.NDArray[np.uint64]],
    order: Int32,
    histograms: Sequence[Int64],
) -> int:
    """Sort the compact stretches that `project` wrote.

    Parameters
    ----------
    depth_bits : (N,) uint32, index : (N,) int32, counts : (chunks,), chunk : see `project`
    keys : two (N,) uint64, scratch
    order : (N,) int32, out
    histograms : two (workers, BUCKETS) int64, scratch

    Returns
    -------
    int
        Number of visible Gaussians V; their indices, nearest first, stand in ``order[:V]``.
    """
    here, there = keys
    starts = np.concatenate([[0], np.cumsum(counts)])
    n, workers = int(starts[-1]), len(histograms[0])
    pack_keys(depth_bits, index, counts, starts, chunk, here)
    for digit in range(3):
        count_digits(here, n, digit, histograms[0], turns=workers)
        move_keys(here, n, digit, *histograms, there, order, turns=workers)
        here, there = there, here
    return n


@parallel_kernel
def pack_keys(depth_bits, index, counts, starts, chunk, keys, call):
    """Depth and index of every visible Gaussian as one number, without the gaps between the stretches."""
    for part in share_of(counts.shape[0], call):
        at = starts[part]
        for j in range(counts[part]):
            keys[at + j] = (np.uint64(depth_bits[part * chunk + j]) << _HALF) | np.uint64(index[part * chunk + j])


@parallel_kernel
def count_digits(keys, n, digit, histograms, call):
    """How often each value of one of the three digits comes in each worker's share of the first n keys."""
    workers = histograms.shape[0]
    share = (n + workers - 1) // workers
    shift = np.uint64(_BITS * digit) + _HALF
    for w in share_of(workers, call):
        own = histograms[w]
        for bucket in range(BUCKETS):
            own[bucket] = 0
        for j in range(w * share, min(n, (w + 1) * share)):
            own[(keys[j] >> shift) & _LOW] += 1


@parallel_kernel
def move_keys(keys, n, digit, histograms, places, moved, order, call):
    """Keys in the order of a digit, after those of their bucket that come before them; of the last digit the indices
    alone, to `order`. `places` is scratch like `histograms`."""
    workers = histograms.shape[0]
    share = (n + workers - 1) // workers
    shift = np.uint64(_BITS * digit) + _HALF
    for w in share_of(workers, call):
        own = places[w]
        total = 0
        for bucket in range(BUCKETS):
            for other in range(workers):
                if other == w:
                    own[bucket] = total
                total += histograms[other, bucket]
        for j in range(w * share, min(n, (w + 1) * share)):
            bucket = (keys[j] >> shift) & _LOW
            to = own[bucket]
            own[bucket] = to + 1
            if digit < 2:
                moved[to] = keys[j]
            else:
                order[to] = np.int32(keys[j] & _INDEX)
