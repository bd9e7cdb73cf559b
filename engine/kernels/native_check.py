"""Whether this machine may call kernels without numba: compared once with numba itself, in a process of its own.

What is kept as machine code comes from numba's internals and is called by a convention that numba does not promise. So
before it is relied on, a kernel with arguments of every kind runs both ways, and both must give the same numbers and
write the same bytes, none outside. Whatever else happens, a crash included, numba runs every kernel here.

Run as a program it makes the comparison and prints what is wrong; nothing where both agree.
"""

import os
import subprocess
import sys
from functools import cache
from typing import Any

import numpy as np

from engine.errors import Mark3DGSError
from engine.kernels import kernel_cache, machine_code
from engine.kernels.deferred import resolved
from engine.kernels.jit import FLOAT_FLAGS, share_of
from engine.kernels.machine import module_command

__all__ = ["calls_native", "difference"]

BEFORE_NUMBA = (0, 69)
"""The first version of numba that nobody has tried; `pyproject.toml` has the same bound."""
SECONDS = 300.0
"""After which a comparison has failed: some seconds, on a machine that may be busy."""


@cache
def calls_native() -> bool:
    """Whether kernels are called as machine code. The environment variable MARK3DGS_KERNELS is `auto`, which is the
    default: where it gives what numba gives; or `numba`: never. Mark3DGSError where it is something else."""
    asked = os.environ.get("MARK3DGS_KERNELS") or "auto"
    if asked not in ("auto", "numba"):
        raise Mark3DGSError(f"MARK3DGS_KERNELS is {asked!r}: it can be 'auto' or 'numba'")
    wrong = "" if asked == "numba" else verdict()
    if wrong:
        kernel_cache.warn_once("KERNELS", f"kernels start more slowly, by numba alone: {wrong}")
    return asked == "auto" and not wrong


def verdict() -> str:
    """What is wrong with machine code here, for this numba, llvmlite and processor; empty where nothing is."""
    numba = kernel_cache.compiler()[0]
    if tuple(int(part) for part in numba.split(".")[:2]) >= BEFORE_NUMBA:
        return f"numba {numba} is newer than what is known here"
    name = kernel_cache.path_of("native", "verdict", sys.version)
    if (kept := kernel_cache.read(name)) is not None:
        return kept.decode(errors="replace")
    wrong = _ask()
    kernel_cache.write(name, wrong.encode())
    return wrong


def _ask() -> str:
    """The verdict of a new process, which machine code that is called in a wrong way may end."""
    command = module_command(__name__)
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=SECONDS, check=False)
    except (OSError, subprocess.SubprocessError) as error:
        return f"the check of machine code did not run: {error}"
    return f"the check of machine code ended with status {done.returncode}" if done.returncode else done.stdout.decode()


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
    arrays = (frozen, rng.standard_normal((n, 3)).astype(np.float32)[:, 1], np.asfortranarray(rng.random((n, 4))))
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
