"""Sums across lanes, sixteen vectors at a time, and the 16 x 16 transpose."""

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-untyped-calls
from typing import Any

from engine.raster.lane_ir import FLAGS, LANES, floats
from engine.raster.lane_memory import load_vector, on_array, vector_at
from engine.raster.lane_order import shuffle
from engine.raster.lanes import lanes


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
