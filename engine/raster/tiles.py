"""What the passes over tiles share: a tile's pixels as vectors, and which blocks of it a Gaussian reaches.

A worker keeps one tile at a time in its own flat float32 scratch. 4 x 4 pixels are a block, one vector; 16
blocks are a tile, so a field of a tile is 256 numbers in block order. The scratch holds

    STATE            transmittance T; minus |T| once the pixel has ended
    GRID_X, GRID_Y   pixel centres relative to the tile's corner
    FIELDS           one field per channel (colours out, or cotangents in), then what the pass needs

Gaussians come in batches of `BATCH`. For each, one vector test finds the blocks its ellipse reaches; the
(Gaussian, block) items of a batch go to a compact list, and the inner loop runs over that list without a
branch.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math

import numpy as np

from engine.kernels.jit import inlined
from engine.raster.disc_projection import LOW_PASS
from engine.raster.lane_math import exp2
from engine.raster.lane_memory import (
    append_set_bits,
    count_bits,
    entry,
    load,
    lowest_bit,
    number,
    prefetch,
    put,
    store,
    store_quarters,
)
from engine.raster.lane_order import unzip3
from engine.raster.lanes import bits_of, constant_lanes, fma, maximum, minimum, minus_magnitude, select, spread
from engine.raster.projection import RECORD
from engine.raster.settings import BLOCK, TILE

BATCH = 32
"""Gaussians per batch; pixels that have ended are looked for once a batch."""

FIELD = TILE * TILE
STATE, GRID_X, GRID_Y, FIELDS = 0, FIELD, 2 * FIELD, 3 * FIELD

STAGE_ROW = 24
"""Floats per staged Gaussian: its record or disc (u, v relative to the tile) at 0, its colours from `RECORD` on."""

ITEMS = BATCH * 16 + 16
"""Length of the item list (int32 each: 16 * place in the batch + block)."""

_f = np.float32
_i = np.int32
_AHEAD = 24  # list entries: about the time that a line takes from memory
_HALF_LOG2_E = _f(-0.5 * math.log2(math.e))

_block_left = constant_lanes([BLOCK * (block % 4) + 0.5 for block in range(16)])
_block_top = constant_lanes([BLOCK * (block // 4) + 0.5 for block in range(16)])


@inlined
def lay_grid(own):
    """Pixel centres of a tile, in block order."""
    for block in range(16):
        for lane in range(16):
            own[GRID_X + block * 16 + lane] = _f((block & 3) * 4 + (lane & 3)) + _f(0.5)
            own[GRID_Y + block * 16 + lane] = _f((block >> 2) * 4 + (lane >> 2)) + _f(0.5)


@inlined
def place_of(p, q):
    """Place in a field of the pixel in column p and row q of a tile."""
    return ((q >> 2) * 4 + (p >> 2)) * 16 + (q & 3) * 4 + (p & 3)


@inlined
def is_inside(x0, y0, width, height):
    """Whether all of a tile lies inside the image: its rows are then read and written as vectors."""
    return x0 + TILE <= width and y0 + TILE <= height


@inlined
def pixels_of_row(pixels, at, channel, channels):
    """One of one or three channels of 16 pixels, from the flat image's index of the first one's first channel on."""
    if channels == 1:
        return load(pixels, at)
    return unzip3(load(pixels, at), load(pixels, at + 16), load(pixels, at + 32))[channel]


@inlined
def fill_field(own, field, pixels, channels, channel, x0, y0, width, height):
    """One channel of an image to a field of the tile at (x0, y0); zero outside the image."""
    if (channels == 1 or channels == 3) and is_inside(x0, y0, width, height):
        for row in range(TILE):
            at = ((y0 + row) * width + x0) * channels
            store_quarters(own, field + place_of(0, row), pixels_of_row(pixels, at, channel, channels))
        return
    for place in range(FIELD):
        own[field + place] = _f(0.0)
    for y in range(y0, min(y0 + TILE, height)):
        for x in range(x0, min(x0 + TILE, width)):
            own[field + place_of(x - x0, y - y0)] = pixels[(y * width + x) * channels + channel]


@inlined
def open_tile(own, x0, y0, width, height):
    """Transmittance 1; pixels outside the image have ended. Returns the blocks with pixels inside it, a bit each."""
    for block in range(16):
        store(own, STATE + block * 16, spread(_f(1.0)))
    if x0 + TILE > width or y0 + TILE > height:
        for place in range(FIELD):
            if x0 + own[GRID_X + place] > width or y0 + own[GRID_Y + place] > height:
                own[STATE + place] = _f(0.0)
    alive = _i(0)
    for block in range(16):
        if y0 + (block >> 2) * 4 < height and x0 + (block & 3) * 4 < width:
            alive |= _i(1 << block)
    return alive


@inlined
def living_blocks(own, alive, stop):
    """The blocks in which some pixel has not ended."""
    rest = alive
    while rest != 0:
        block = lowest_bit(rest)
        rest &= rest - _i(1)
        if bits_of(load(own, STATE + np.int64(block) * 16) > stop) == 0:
            alive &= ~_i(1 << block)
    return alive


@inlined
def reached_blocks(records, o, gx, gy, log2_skip):
    """Bit per block: does q reach log2_skip inside the rectangle of the block's pixel centres?

    q is concave, so over a rectangle it peaks at the centre or on the edge nearest to the centre in x or in y.
    The lanes are the 16 blocks.
    """
    a, b, c, l = number(records, o + 2), number(records, o + 3), number(records, o + 4), number(records, o + 5)
    left, top = _block_left() - gx, _block_top() - gy
    right, bottom = left + _f(BLOCK - 1), top + _f(BLOCK - 1)
    zero = spread(_f(0.0))
    x = minimum(maximum(zero, left), right)
    y = minimum(maximum(zero, top), bottom)
    along_y = minimum(maximum(x * number(records, o + 7), top), bottom)
    along_x = minimum(maximum(y * number(records, o + 6), left), right)
    on_x = fma(fma(a, x, along_y * b), x, fma(along_y * c, along_y, l))
    on_y = fma(fma(a, along_x, y * b), along_x, fma(y * c, y, l))
    return bits_of((on_x >= log2_skip) | (on_y >= log2_skip))


@inlined
def stage_batch(own, stage, items, records, discs, colors, channels, ids, at, size, end, x0, y0, alive, log2_skip):
    """Copy the Gaussians ids[at : at + size] to the scratch and list their items; returns how many items.

    `discs` is empty for Gaussians, None where a pass knows nothing else; for discs (2DGS) they are what is staged, and
    `records` only find the blocks.
    """
    count = np.int64(0)
    for j in range(size):
        if at + j + _AHEAD < end:
            ahead = np.int64(entry(ids, at + j + _AHEAD))
            prefetch(records, ahead * RECORD)
            if discs is not None and discs.shape[0] > 0:
                prefetch(discs, ahead * RECORD)
            if channels > 0:
                prefetch(colors, ahead * channels)
        i = np.int64(entry(ids, at + j))
        o, row = i * RECORD, stage + j * STAGE_ROW
        gx, gy = number(records, o) - x0, number(records, o + 1) - y0
        if discs is None or discs.shape[0] == 0:
            store(own, row, load(records, o))  # reads on into the next record; the array ends with spare room
            put(own, row, gx)
            put(own, row + 1, gy)
        else:
            store(own, row, load(discs, o))
            put(own, row, number(own, row) - x0)
            put(own, row + 1, number(own, row + 1) - y0)
        for channel in range(channels):
            put(own, row + RECORD + channel, number(colors, i * channels + channel))
        reached = reached_blocks(records, o, gx, gy, log2_skip) & alive
        append_set_bits(items, count, reached, _i(j << 4))
        count += np.int64(count_bits(reached))
    return count


@inlined
def disc_log2_alpha(own, row, dx, dy):
    """q of a staged disc: where the ray meets it, or the low pass if that is more. See `disc_projection`."""
    p0, p1 = dx * number(own, row + 2), fma(dx, number(own, row + 3), dy * number(own, row + 4))
    g = _f(1.0) - p0 * number(own, row + 5) - p1 * number(own, row + 6)
    met = select(g > _f(0.0), fma(p0, p0, p1 * p1) / (g * g), spread(_f(np.inf)))
    near = fma(dx, dx, dy * dy) * _f(LOW_PASS)
    return minimum(met, near) * _HALF_LOG2_E + number(own, row + 7)  # a NaN is no smaller: then the low pass counts


@inlined
def open_item(own, stage, item, discs):
    """An item's place in a field, number in the batch and staged row; and over its block the offsets (dx, dy) from
    the centre and q: alpha = 2^q."""
    place, j = np.int64(item & _i(15)) * 16, np.int64(item >> _i(4))
    row = stage + j * STAGE_ROW
    dx, dy = load(own, GRID_X + place) - number(own, row), load(own, GRID_Y + place) - number(own, row + 1)
    if discs is not None and discs.shape[0] > 0:
        return place, j, row, dx, dy, disc_log2_alpha(own, row, dx, dy)
    q = fma(
        fma(number(own, row + 2), dx, dy * number(own, row + 3)),
        dx,
        fma(dy * number(own, row + 4), dy, number(own, row + 5)),
    )
    return place, j, row, dx, dy, q


@inlined
def blend(q, transmittance, log2_skip, clamp, stop):
    """Blend one Gaussian over the pixels of a block.

    Returns alpha before the clamp, the blending weight w (0 where it is skipped or the pixel has ended) and
    the transmittance afterwards (minus its magnitude where the pixel has ended).
    """
    zero = spread(_f(0.0))
    alpha = exp2(q)
    weight = select(q >= log2_skip, minimum(alpha, clamp) * transmittance, zero)
    after = transmittance - weight
    blended = after > stop
    return alpha, select(blended, weight, zero), select(blended, after, minus_magnitude(transmittance))
