"""Lanes to and from memory. Arrays are flat float32; indices count elements."""

# mypy: allow-untyped-decorators, allow-subclassing-any, allow-untyped-calls
import itertools
from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from engine.raster.lanes import BOOLS, FLOATS, INT32, INTS, LANES, broadcast, call_llvm, floats, lanes

INT16 = ir.IntType(16)
_CACHE_LINE = 64
_HUGE_PAGE = 2 << 20
_shifts = itertools.cycle(range(0, 64 * 17 * 16, 64 * 17))


def aligned(shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
    """Uninitialised array that starts on a cache line; a large one on a huge page.

    The passes jump about in memory, and address translation by 4 KiB pages costs them a third of their
    time. NumPy asks Linux for huge pages for blocks from 4 MiB on.
    """
    kind = np.dtype(dtype)
    size = int(np.prod(shape)) * kind.itemsize
    small = size < _HUGE_PAGE // 2
    line = _CACHE_LINE if small else _HUGE_PAGE
    shift = 0 if small else next(_shifts)  # equal places in their pages would make arrays fight for cache sets
    raw = np.empty(-(-(size + shift) // line) * line + line, np.uint8)
    start = -raw.ctypes.data % line + shift
    return raw[start : start + size].view(kind).reshape(shape)


def pointer_to(context: Any, b: Any, array_type: Any, array: Any, index: Any) -> Any:
    """IR: address of array[index]."""
    return b.gep(context.make_array(array_type)(context, b, array).data, [index])


def _vector_pointer(context: Any, b: Any, sig: Any, args: Any) -> Any:
    return b.bitcast(pointer_to(context, b, sig.args[0], args[0], args[1]), FLOATS.as_pointer())


@intrinsic
def load(typing: Any, array: Any, index: Any) -> Any:
    """array[index : index + 16]."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        value = b.load(_vector_pointer(context, b, sig, args), typ=FLOATS)
        value.align = 4
        return value

    return lanes(array, types.intp), emit


@intrinsic
def store(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """array[index : index + 16] = value."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        b.store(args[2], _vector_pointer(context, b, sig, args)).align = 4
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), emit


@intrinsic
def load_some(typing: Any, array: Any, index: Any, count: Any) -> Any:
    """array[index : index + count] and zeros after it; count may be anything, also negative. Reads no
    further."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        pointer = _vector_pointer(context, b, sig, args)
        kind = ir.FunctionType(FLOATS, [pointer.type, INT32, BOOLS, FLOATS])
        function = cgutils.get_or_insert_function(b.module, kind, f"llvm.masked.load.v{LANES}f32.p0")
        return b.call(function, [pointer, ir.Constant(INT32, 4), _first_lanes(b, args[2]), floats(0)])

    return lanes(array, types.intp, types.int32), emit


@intrinsic
def store_some(typing: Any, array: Any, index: Any, count: Any, value: Any) -> Any:
    """array[index : index + count] = the first lanes; count may be anything, also negative."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        pointer = _vector_pointer(context, b, sig, args)
        kind = ir.FunctionType(ir.VoidType(), [FLOATS, pointer.type, INT32, BOOLS])
        function = cgutils.get_or_insert_function(b.module, kind, f"llvm.masked.store.v{LANES}f32.p0")
        b.call(function, [args[3], pointer, ir.Constant(INT32, 4), _first_lanes(b, args[2])])
        return context.get_dummy_value()

    return types.void(array, types.intp, types.int32, lanes), emit


def _first_lanes(b: Any, count: Any) -> Any:
    """IR: mask of the lanes below count."""
    return b.icmp_signed("<", ir.Constant(INTS, list(range(LANES))), broadcast(b, count, INTS))


def shuffle(b: Any, x: Any, y: Any, lanes_of_xy: list[int]) -> Any:
    """IR: lanes 0-15 are x, 16-31 are y."""
    return b.shuffle_vector(x, y, ir.Constant(INTS, lanes_of_xy))


@intrinsic
def unzip3(typing: Any, x: Any, y: Any, z: Any) -> Any:
    """48 numbers r g b r g b ... in three vectors, as (r, g, b)."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        parts = []
        for channel in range(3):
            wanted = [3 * i + channel for i in range(LANES)]  # positions in the 48
            low = shuffle(b, args[0], args[1], [p if p < 32 else 0 for p in wanted])
            parts.append(shuffle(b, low, args[2], [i if p < 32 else p - 16 for i, p in enumerate(wanted)]))
        return context.make_tuple(b, sig.return_type, parts)

    return types.UniTuple(lanes, 3)(lanes, lanes, lanes), emit


@intrinsic
def zip3(typing: Any, x: Any, y: Any, z: Any) -> Any:
    """(r, g, b) as 48 numbers r g b r g b ... in three vectors: the inverse of `unzip3`."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        parts = []
        for part in range(3):
            sources = [divmod(part * LANES + i, 3) for i in range(LANES)]  # (lane, channel)
            pair = shuffle(b, args[0], args[1], [lane + 16 * min(c, 1) for lane, c in sources])
            chosen = [i if c < 2 else 16 + lane for i, (lane, c) in enumerate(sources)]
            parts.append(shuffle(b, pair, args[2], chosen))
        return context.make_tuple(b, sig.return_type, parts)

    return types.UniTuple(lanes, 3)(lanes, lanes, lanes), emit


@intrinsic
def unzip4(typing: Any, a: Any, b_: Any, c: Any, d: Any) -> Any:
    """64 numbers w x y z w x y z ... in four vectors, as (w, x, y, z)."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        parts = []
        for channel in range(4):
            picks = [4 * i + channel for i in range(8)] * 2  # of 32 numbers, 8 belong to the channel
            low = shuffle(b, args[0], args[1], picks)
            high = shuffle(b, args[2], args[3], picks)
            parts.append(shuffle(b, low, high, [*range(8), *range(16, 24)]))
        return context.make_tuple(b, sig.return_type, parts)

    return types.UniTuple(lanes, 4)(lanes, lanes, lanes, lanes), emit


@intrinsic
def zip4(typing: Any, w: Any, x: Any, y: Any, z: Any) -> Any:
    """(w, x, y, z) as 64 numbers w x y z w x y z ... in four vectors: the inverse of `unzip4`."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        parts = []
        for part in range(4):
            from_lane = [part * 4 + i // 4 for i in range(LANES)]
            low = shuffle(b, args[0], args[1], [lane + 16 * (i % 2) for i, lane in enumerate(from_lane)])
            high = shuffle(b, args[2], args[3], [lane + 16 * (i % 2) for i, lane in enumerate(from_lane)])
            parts.append(shuffle(b, low, high, [i if i % 4 < 2 else 16 + i for i in range(LANES)]))
        return context.make_tuple(b, sig.return_type, parts)

    return types.UniTuple(lanes, 4)(lanes, lanes, lanes, lanes), emit


@intrinsic
def prefetch(typing: Any, array: Any, index: Any) -> Any:
    """Ask for the cache line of array[index]."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        pointer = b.bitcast(pointer_to(context, b, sig.args[0], args[0], args[1]), ir.IntType(8).as_pointer())
        read, near, data = (ir.Constant(INT32, v) for v in (0, 3, 1))
        call_llvm(b, "llvm.prefetch.p0", ir.VoidType(), [pointer, read, near, data])
        return context.get_dummy_value()

    return types.void(array, types.intp), emit


@intrinsic
def fetch_add(typing: Any, array: Any, index: Any, amount: Any) -> Any:
    """Atomically add to an int64 array; returns the value before."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        pointer = pointer_to(context, b, sig.args[0], args[0], args[1])
        return b.atomic_rmw("add", pointer, args[2], "monotonic")

    return types.int64(array, types.intp, types.int64), emit


@intrinsic
def append_set_bits(typing: Any, array: Any, index: Any, bits: Any, base: Any) -> Any:
    """Write base | lane to the int32 array from index on, for every set bit of the low 16, ascending."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        pointer = pointer_to(context, b, sig.args[0], args[0], args[1])
        chosen = b.bitcast(b.trunc(args[2], INT16), BOOLS)
        values = b.or_(broadcast(b, args[3], INTS), ir.Constant(INTS, list(range(LANES))))
        call_llvm(b, f"llvm.masked.compressstore.v{LANES}i32", ir.VoidType(), [values, pointer, chosen])
        return context.get_dummy_value()

    return types.void(array, types.intp, types.int32, types.int32), emit


@intrinsic
def count_bits(typing: Any, x: Any) -> Any:
    """Number of set bits of an int32."""
    return types.int32(types.int32), lambda context, b, sig, args: call_llvm(b, "llvm.ctpop.i32", INT32, [args[0]])


@intrinsic
def lowest_bit(typing: Any, x: Any) -> Any:
    """Index of the lowest set bit of a non-zero int32."""
    return types.int32(types.int32), lambda context, b, sig, args: call_llvm(
        b, "llvm.cttz.i32", INT32, [args[0], ir.Constant(ir.IntType(1), 1)]
    )
