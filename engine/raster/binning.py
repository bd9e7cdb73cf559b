"""Pass 3: per tile, the list of Gaussians that touch it, front to back.

A Gaussian enters exactly the tiles whose pixel centres its ellipse {alpha >= alpha_skip} can reach: those that pass 1
has stored as bits where it is small, else per row of tiles the ellipse's span in x. One walk over the depth order notes
the pairs and counts them per tile, a second pass puts them in place. Both split the order into contiguous shares, so
lists come out in depth order whatever the number of shares. A tile mask leaves tiles out altogether.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math

import numpy as np

from engine.kernels.jit import inlined, kernel, parallel_kernel, share_of
from engine.raster.lane_memory import lowest_bit, prefetch
from engine.raster.projection import COVER, RECORD
from engine.raster.settings import TILE

__all__ = ["list_pairs", "list_starts", "place_pairs"]


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
