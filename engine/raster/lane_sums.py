"""Sums and maxima across lanes, sixteen vectors at a time, and the 16 x 16 transpose."""

# mypy: allow-untyped-decorators, allow-subclassing-any, allow-untyped-calls
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from engine.raster.lane_memory import pointer_to, shuffle
from engine.raster.lanes import FLAGS, FLOATS, LANES, floats, lanes


def _fold(b: Any, x: Any, y: Any, distance: int, combine: Any) -> Any:
    """Halve two vectors by combining lanes `distance` apart; x and y alternate in groups of that many
    lanes."""
    near: list[int] = []
    far: list[int] = []
    for start in range(0, LANES, 2 * distance):
        here = list(range(start, start + distance))
        near += here + [16 + i for i in here]
        far += [i + distance for i in here] + [16 + i + distance for i in here]
    return combine(b, shuffle(b, x, y, near), shuffle(b, x, y, far))


def _transposed(b: Any, rows: list[Any], combine: Any) -> Any:
    """One vector whose lane k combines all lanes of row k; missing rows give zero."""
    current = rows + [None] * (LANES - len(rows))
    for distance in (8, 4, 2, 1):
        half = len(current) // 2
        pairs = zip(current[:half], current[half:], strict=True)
        current = [
            None
            if x is None and y is None
            else _fold(b, floats(0) if x is None else x, floats(0) if y is None else y, distance, combine)
            for x, y in pairs
        ]
    return current[0]


def _add(b: Any, x: Any, y: Any) -> Any:
    return b.fadd(x, y, flags=FLAGS)


def _max(b: Any, x: Any, y: Any) -> Any:
    return b.select(b.fcmp_ordered(">", x, y), x, y)


def _row_reduction(combine: Any) -> Any:
    @intrinsic
    def reduce_rows(typing: Any, array: Any, index: Any, rows: Any) -> Any:
        """Lane k of the result combines the 16 numbers of row k; rows is a tuple whose length says how
        many."""
        count = len(rows)

        def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
            vectors = []
            for row in range(count):
                at = b.add(args[1], ir.Constant(args[1].type, row * LANES))
                pointer = pointer_to(context, b, sig.args[0], args[0], at)
                vector = b.load(b.bitcast(pointer, FLOATS.as_pointer()), typ=FLOATS)
                vector.align = 4
                vectors.append(vector)
            return _transposed(b, vectors, combine)

        return lanes(array, types.intp, rows), emit

    return reduce_rows


sum_rows = _row_reduction(_add)
max_rows = _row_reduction(_max)


@intrinsic
def transpose(typing: Any, array: Any, source: Any, target: Any) -> Any:
    """The 16 x 16 numbers at `target` become the transpose of those at `source`."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        def place(start: Any, row: int) -> Any:
            at = b.add(start, ir.Constant(start.type, row * LANES))
            return b.bitcast(pointer_to(context, b, sig.args[0], args[0], at), FLOATS.as_pointer())

        rows = [b.load(place(args[1], row), typ=FLOATS) for row in range(LANES)]
        for vector in rows:
            vector.align = 4
        for distance in (8, 4, 2, 1):  # swap the off-diagonal quarters, then those of the quarters, ...
            upper = [lane if not lane & distance else LANES + lane - distance for lane in range(LANES)]
            lower = [lane + distance if not lane & distance else LANES + lane for lane in range(LANES)]
            for row in range(LANES):
                if not row & distance:
                    x, y = rows[row], rows[row + distance]
                    rows[row], rows[row + distance] = shuffle(b, x, y, upper), shuffle(b, x, y, lower)
        for row, vector in enumerate(rows):
            b.store(vector, place(args[2], row)).align = 4
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp), emit
