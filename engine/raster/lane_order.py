"""Lanes in another order: shuffles, and numbers that lie interleaved in memory taken apart and put together."""

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-untyped-calls
from typing import Any

from llvmlite import ir

from engine.raster.lane_ir import INT32, INTS, LANES, REGISTER
from engine.raster.lanes import ir_function, lanes

_THREE, _FOUR = (lanes, 3), (lanes, 4)


def together(b: Any, values: list[Any]) -> Any:
    """IR: a tuple of values of one type."""
    packed = ir.Constant(ir.ArrayType(values[0].type, len(values)), ir.Undefined)
    for place, value in enumerate(values):
        packed = b.insert_value(packed, value, place)
    return packed


def shuffle(b: Any, x: Any, y: Any, lanes_of_xy: list[int]) -> Any:
    """IR: lanes 0-15 are x, 16-31 are y."""
    return b.shuffle_vector(x, y, ir.Constant(INTS, lanes_of_xy))


def _blend(b: Any, vectors: list[Any], source_of_lane: list[int]) -> Any:
    """IR: lane k is lane k of vectors[source_of_lane[k]]; no lane moves."""
    size = len(source_of_lane)
    value = vectors[0]
    for which, vector in enumerate(vectors[1:], 1):
        picks = [size + k if source == which else k for k, source in enumerate(source_of_lane)]
        value = b.shuffle_vector(value, vector, ir.Constant(ir.VectorType(INT32, size), picks))
    return value


def permute(b: Any, vector: Any, lanes_of: list[int]) -> Any:
    """IR: lane k is lane lanes_of[k] of the vector."""
    return b.shuffle_vector(vector, vector, ir.Constant(ir.VectorType(INT32, len(lanes_of)), lanes_of))


def _pieces(b: Any, vectors: list[Any]) -> list[Any]:
    """IR: the vectors cut into registers of this processor, in order."""
    if REGISTER == LANES:
        return vectors
    return [
        permute(b, vector, list(range(at, at + REGISTER))) for vector in vectors for at in range(0, LANES, REGISTER)
    ]


def joined(b: Any, pieces: list[Any]) -> list[Any]:
    """IR: pieces in order as vectors; the inverse of `_pieces`."""
    while pieces[0].type.count < LANES:
        order = list(range(2 * pieces[0].type.count))
        order = ir.Constant(ir.VectorType(INT32, len(order)), order)
        pieces = [b.shuffle_vector(low, high, order) for low, high in zip(pieces[::2], pieces[1::2], strict=True)]
    return pieces


# Of three registers r g b r g b ... each channel has its numbers in other lanes, 3 being no divisor of their count: two
# blends gather a channel and one permutation orders it. A shuffle of two wide vectors takes a narrow machine many.


@ir_function(_THREE, lanes, lanes, lanes)
def unzip3(b, x, y, z):
    """48 numbers r g b r g b ... in three vectors, as (r, g, b)."""
    pieces = _pieces(b, [x, y, z])
    channels: list[list[Any]] = [[], [], []]
    for at in range(0, len(pieces), 3):
        for channel, found in enumerate(channels):
            places = [3 * i + channel for i in range(REGISTER)]
            source = {place % REGISTER: place // REGISTER for place in places}
            gathered = _blend(b, pieces[at : at + 3], [source[lane] for lane in range(REGISTER)])
            found.append(permute(b, gathered, [place % REGISTER for place in places]))
    return together(b, [joined(b, found)[0] for found in channels])


@ir_function(_THREE, lanes, lanes, lanes)
def zip3(b, x, y, z):
    """(r, g, b) as 48 numbers r g b r g b ... in three vectors: the inverse of `unzip3`."""
    channels = [_pieces(b, [each]) for each in (x, y, z)]
    pieces = []
    for group in range(len(channels[0])):
        spread_out = []
        for channel, parts in enumerate(channels):
            lane_of = {(3 * i + channel) % REGISTER: i for i in range(REGISTER)}
            spread_out.append(permute(b, parts[group], [lane_of[lane] for lane in range(REGISTER)]))
        for part in range(3):
            pieces.append(_blend(b, spread_out, [(part * REGISTER + lane) % 3 for lane in range(REGISTER)]))
    return together(b, joined(b, pieces))


@ir_function(_FOUR, lanes, lanes, lanes, lanes)
def unzip4(b, w, x, y, z):
    """64 numbers w x y z w x y z ... in four vectors, as (w, x, y, z)."""
    parts = []
    for channel in range(4):
        picks = [4 * i + channel for i in range(8)] * 2  # of 32 numbers, 8 belong to the channel
        low, high = shuffle(b, w, x, picks), shuffle(b, y, z, picks)
        parts.append(shuffle(b, low, high, [*range(8), *range(16, 24)]))
    return together(b, parts)


@ir_function(_FOUR, lanes, lanes, lanes, lanes)
def zip4(b, w, x, y, z):
    """(w, x, y, z) as 64 numbers w x y z w x y z ... in four vectors: the inverse of `unzip4`."""
    parts = []
    for part in range(4):
        picks = [part * 4 + i // 4 + 16 * (i % 2) for i in range(LANES)]
        low, high = shuffle(b, w, x, picks), shuffle(b, y, z, picks)
        parts.append(shuffle(b, low, high, [i if i % 4 < 2 else 16 + i for i in range(LANES)]))
    return together(b, parts)
