"""One kernel with arguments of every kind, as machine code and by numba: both must give the same numbers and write the
same bytes, none outside.

Run as a program it prints what is wrong; nothing where both agree.
"""

import sys
from typing import Any

import numpy as np

from engine.kernels import machine_code
from engine.kernels.deferred import resolved
from engine.kernels.jit import FLOAT_FLAGS, share_of


def _probe(doubles, singles, grid, bytes_, flags, out, counts, pair, scale, small, on, nothing, call):  # type: ignore[no-untyped-def]
    weight, (shift, steps) = pair
    if nothing is None:
        shift += 1.0
    total = 0.0
    for i in share_of(len(out), call):
        out[i] = np.exp(doubles[i] * weight) + singles[i] * scale + shift if flags[i] or not on else -doubles[i]
        counts[i] += bytes_[i] * steps[i % 2] - small
        for j in range(grid.shape[1]):
            total += grid[i, j] * (j + 1)
    return total, len(out), on, np.float32(scale)


MARGIN = 8


def _arguments() -> tuple[tuple[Any, ...], list[np.ndarray[Any, Any]]]:
    """Arguments of every kind, and the buffers behind those that are written to, wider by `MARGIN` at both ends."""
    rng, n = np.random.default_rng(0), 37
    frozen = rng.standard_normal(n)
    frozen.flags.writeable = False
    out, counts = np.full(n + 2 * MARGIN, 0.5, np.float32), np.arange(n + 2 * MARGIN)
    arrays: tuple[Any, ...] = (
        frozen,
        rng.standard_normal((n, 3)).astype(np.float32)[:, 1],
        np.asfortranarray(rng.random((n, 4))),
    )
    arrays += (rng.integers(0, 255, n, np.uint8), rng.random(n) < 0.5, out[MARGIN:-MARGIN], counts[MARGIN:-MARGIN])
    pair = (0.75, (-2.0, np.array([3, 5], np.int32)))
    return (*arrays, pair, np.float32(1.25), np.int16(-7), True, None), [out, counts]


def _run(ways: tuple[Any, Any]) -> list[list[Any]]:
    """What each way gives: its numbers for each share, and the buffers afterwards."""
    given = []
    for way in ways:
        arguments, buffers = _arguments()
        numbers = [way((*arguments, (number, 3))) for number in range(3)]
        given.append([repr([[float(each) for each in turn] for turn in numbers]), *(b.tobytes() for b in buffers)])
    return given


def difference() -> str:
    """What is wrong with machine code that is kept and called without numba; empty where nothing is."""
    from engine.kernels.compiler import compile_kernel, dispatcher

    function = resolved(_probe)
    code = compile_kernel(function, FLOAT_FLAGS, (*_arguments()[0], (0, 3)))
    native = code and machine_code.load(code)
    if native is None:
        return "this numba makes no machine code that can be called"
    by_numba = dispatcher(function, FLOAT_FLAGS, allocates=False)
    one, other = _run((lambda given: native(*machine_code.flatten(given, [])), lambda given: by_numba(*given)))
    return "" if one == other else "machine code gives other results than numba"


if __name__ == "__main__":
    try:
        sys.stdout.write(difference())
    except Exception as error:  # whatever numba or LLVM raises, machine code is not for this machine
        sys.stdout.write(f"numba's internals are not what is known here: {type(error).__name__}: {error}")
