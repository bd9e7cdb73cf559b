"""Lanes to and from memory, sums across them, and a transpose. Arrays are flat float32; indices count elements."""

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-untyped-calls
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir

from engine.kernels.deferred import Deferred
from engine.raster.lane_ir import FLAGS, FLOAT, FLOATS, INT32, INTS, LANES, broadcast, call_llvm, floats
from engine.raster.lane_order import joined, permute, shuffle
from engine.raster.lanes import TYPES, ir_function, lanes

_EIGHT_BYTES, _EIGHT_INTS = ir.VectorType(ir.IntType(8), 8), ir.VectorType(INT32, 8)
_FOUR_FLOATS = ir.VectorType(FLOAT, 4)
_LANE_NUMBERS = ir.Constant(INTS, list(range(LANES)))
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


def on_array(result: Any, *arguments: Any) -> Callable[..., Deferred]:
    """Decorator: an intrinsic of an array and these types, out of a function that emits its IR from the builder, a
    function from an index of the array to its address, and the values; of a tuple (None) it gets the length."""

    def decorate(emit: Callable[..., Any]) -> Deferred:
        def compiled() -> Any:
            from engine.raster.lane_types import array_function_of

            return array_function_of(emit, result, arguments)

        return Deferred(emit, compiled, (result, arguments, TYPES))

    return decorate


def vector_at(b: Any, pointer: Any, row: int = 0) -> Any:
    """IR: an address as that of a vector, so many vectors further on."""
    return b.gep(b.bitcast(pointer, FLOATS.as_pointer()), [ir.Constant(INT32, row)])


def load_vector(b: Any, pointer: Any, row: int = 0) -> Any:
    """IR: the vector at an address, or so many further on."""
    value = b.load(vector_at(b, pointer, row), typ=FLOATS)
    value.align = 4
    return value


@on_array(lanes, "intp")
def load(b, at, index):
    """array[index : index + 16]."""
    return load_vector(b, at(index))


@on_array("void", "intp", lanes)
def store(b, at, index, value):
    """array[index : index + 16] = value."""
    b.store(value, vector_at(b, at(index))).align = 4


def _quarter(b: Any, at: Any, index: Any, block: int) -> Any:
    """IR: the address of four numbers, in the vector so many vectors on from an index."""
    return b.gep(b.bitcast(at(index), _FOUR_FLOATS.as_pointer()), [ir.Constant(INT32, block * LANES // 4)])


@on_array(lanes, "intp")
def load_quarters(b, at, index):
    """Four numbers each of four vectors in a row, of which the first begins at array[index]."""
    return joined(b, [_load_quarter(b, _quarter(b, at, index, block)) for block in range(4)])[0]


def _load_quarter(b: Any, pointer: Any) -> Any:
    value = b.load(pointer, typ=_FOUR_FLOATS)
    value.align = 4
    return value


@on_array("void", "intp", lanes)
def store_quarters(b, at, index, value):
    """The inverse of `load_quarters`."""
    for block in range(4):
        b.store(permute(b, value, [4 * block + k for k in range(4)]), _quarter(b, at, index, block)).align = 4


@on_array("float32", "intp")
def number(b, at, index):
    """array[index], which may not be negative: Python's count from the end costs a comparison at every access."""
    return b.load(at(index), typ=FLOAT)


@on_array("void", "intp", "float32")
def put(b, at, index, value):
    """array[index] = value, index as of `number`."""
    b.store(value, at(index))


@on_array("int32", "intp")
def entry(b, at, index):
    """As `number`, of an int32 array."""
    return b.load(at(index), typ=INT32)


def _first_lanes(b: Any, count: Any) -> Any:
    """IR: mask of the lanes below count."""
    return b.icmp_signed("<", _LANE_NUMBERS, broadcast(b, count, INTS))


@on_array(lanes, "intp", "int32")
def load_some(b, at, index, count):
    """array[index : index + count] and zeros after it; count may be anything, also negative. Reads no further."""
    arguments = [vector_at(b, at(index)), ir.Constant(INT32, 4), _first_lanes(b, count), floats(0)]
    return call_llvm(b, f"llvm.masked.load.v{LANES}f32.p0", FLOATS, arguments)


@on_array("void", "intp", "int32", lanes)
def store_some(b, at, index, count, value):
    """array[index : index + count] = the first lanes; count may be anything, also negative."""
    arguments = [value, vector_at(b, at(index)), ir.Constant(INT32, 4), _first_lanes(b, count)]
    call_llvm(b, f"llvm.masked.store.v{LANES}f32.p0", ir.VoidType(), arguments)


@on_array("void", "intp")
def prefetch(b, at, index):
    """Ask for the cache line of array[index]."""
    read, near, data = (ir.Constant(INT32, v) for v in (0, 3, 1))
    pointer = b.bitcast(at(index), ir.IntType(8).as_pointer())
    call_llvm(b, "llvm.prefetch.p0", ir.VoidType(), [pointer, read, near, data])


@on_array("int64", "intp", "int64")
def fetch_add(b, at, index, amount):
    """Atomically add to an int64 array; returns the value before."""
    return b.atomic_rmw("add", at(index), amount, "monotonic")


def _places_of_bits(module: Any) -> Any:
    """IR: for every byte, the places of its set bits, ascending, in eight bytes."""
    name = "places_of_bits"
    if name not in module.globals:
        rows = [[bit for bit in range(8) if byte >> bit & 1] for byte in range(256)]
        table = ir.Constant(
            ir.ArrayType(_EIGHT_BYTES, 256), [ir.Constant(_EIGHT_BYTES, r + [0] * (8 - len(r))) for r in rows]
        )
        held = ir.GlobalVariable(module, table.type, name)
        held.initializer, held.linkage, held.global_constant = table, "internal", True
    return module.globals[name]


@on_array("void", "intp", "int32", "int32")
def append_set_bits(b, at, index, bits, base):
    """Write base | lane to the int32 array from index on, for every set bit of the low 16, ascending; what it writes
    behind them, as far as index + 16, is garbage.

    By a table of bytes: a masked compress-store is one instruction of AVX-512 and 16 branches anywhere else.
    """
    table = _places_of_bits(b.module)
    for half in (0, 8):
        byte = b.and_(b.lshr(bits, ir.Constant(INT32, half)), ir.Constant(INT32, 255))
        places = b.load(b.gep(table, [ir.Constant(INT32, 0), byte]), typ=_EIGHT_BYTES)
        places.align = 8
        values = b.or_(b.zext(places, _EIGHT_INTS), broadcast(b, b.or_(base, ir.Constant(INT32, half)), _EIGHT_INTS))
        b.store(values, b.bitcast(at(index), _EIGHT_INTS.as_pointer())).align = 4
        index = b.add(index, b.zext(call_llvm(b, "llvm.ctpop.i32", INT32, [byte]), index.type))


@ir_function("int32", "int32")
def count_bits(b, x):
    """Number of set bits."""
    return call_llvm(b, "llvm.ctpop.i32", INT32, [x])


@ir_function("int32", "int32")
def lowest_bit(b, x):
    """Index of the lowest set bit of a number that is not 0."""
    return call_llvm(b, "llvm.cttz.i32", INT32, [x, ir.Constant(ir.IntType(1), 1)])


def _fold(b: Any, x: Any, y: Any, distance: int) -> Any:
    """Halve two vectors by adding lanes `distance` apart; x and y alternate in groups of that many
    lanes."""
    near: list[int] = []
    far: list[int] = []
    for start in range(0, LANES, 2 * distance):
        here = list(range(start, start + distance))
        near += here + [16 + i for i in here]
        far += [i + distance for i in here] + [16 + i + distance for i in here]
    return b.fadd(shuffle(b, x, y, near), shuffle(b, x, y, far), flags=FLAGS)


def _summed(b: Any, rows: list[Any]) -> Any:
    """One vector whose lane k sums all lanes of row k; missing rows give zero."""
    current = rows + [None] * (LANES - len(rows))
    for distance in (8, 4, 2, 1):
        half = len(current) // 2
        pairs = zip(current[:half], current[half:], strict=True)
        current = [
            None
            if x is None and y is None
            else _fold(b, floats(0) if x is None else x, floats(0) if y is None else y, distance)
            for x, y in pairs
        ]
    return current[0]


@on_array(lanes, "intp", None)
def sum_rows(b, at, index, count):
    """Lane k of the result is the sum of the 16 numbers of row k, for as many rows as the tuple `count` is long."""
    rows = [load_vector(b, at(index), row) for row in range(count)]
    return _summed(b, rows)


@on_array("void", "intp", "intp")
def transpose(b, at, source, target):
    """The 16 x 16 numbers at `target` become the transpose of those at `source`."""
    rows = [load_vector(b, at(source), row) for row in range(LANES)]
    for distance in (8, 4, 2, 1):  # swap the off-diagonal quarters, then those of the quarters, ...
        upper = [lane if not lane & distance else LANES + lane - distance for lane in range(LANES)]
        lower = [lane + distance if not lane & distance else LANES + lane for lane in range(LANES)]
        for row in range(LANES):
            if not row & distance:
                x, y = rows[row], rows[row + distance]
                rows[row], rows[row + distance] = shuffle(b, x, y, upper), shuffle(b, x, y, lower)
    for row, vector in enumerate(rows):
        b.store(vector, vector_at(b, at(target), row)).align = 4
