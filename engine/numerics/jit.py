"""The numba options of the whole program, in one place.

No option set here carries the no-NaN or no-infinity flags: with full ``fastmath`` an ``isnan`` guard silently
vanishes. Nor does any carry ``reassoc``: it lets LLVM cancel the magic constant of the exponential's range
reduction (measured: 35 dB images).

Numba's disk cache looks at the date of the file that defines a kernel, not at what that file imports. So
every file of kernels holds a ``_KERNEL_VERSION``; raise it when something the kernels import has changed.
"""

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

# Idle OpenMP workers sleep instead of spinning: next to torch's own pool, spinning costs 2 to 20 times on a
# busy machine. It must be set before the first parallel kernel starts the pool.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numba

__all__ = ["FLOAT_FLAGS", "inlined", "kernel", "parallel_kernel", "parallel_section", "side_by_side", "thread_count"]

FLOAT_FLAGS = frozenset({"nsz", "arcp", "contract", "afn"})
"""Floating-point freedoms given to LLVM: signed zeros, reciprocals, fused multiply-add, approximate
functions."""

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "boundscheck": False,
    "error_model": "numpy",  # no division-by-zero checks: they stop vectorization
    "fastmath": set(FLOAT_FLAGS),
}
_SAFE_FOR_CONCURRENT_CALLERS = {"omp", "tbb"}

_section = threading.RLock()

A = TypeVar("A")
B = TypeVar("B")


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a single-threaded kernel."""
    return numba.njit(**_OPTIONS)(function)  # type: ignore[no-any-return]  # numba is untyped


def parallel_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel that may use `numba.prange`; call it inside `parallel_section`."""
    return numba.njit(parallel=True, **_OPTIONS)(function)  # type: ignore[no-any-return]  # numba is untyped


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a piece of a kernel that LLVM inlines wherever it is called."""
    options = {name: value for name, value in _OPTIONS.items() if name not in ("cache", "nogil")}
    return numba.njit(forceinline=True, **options)(function)  # type: ignore[no-any-return]  # numba is untyped


def thread_count() -> int:
    """Number of threads the next parallel kernel will use (`numba.set_num_threads`, per calling thread)."""
    return int(numba.get_num_threads())


@contextmanager
def parallel_section() -> Iterator[None]:
    """Guard the launch of parallel kernels where numba's thread layer cannot take two callers at once.

    Numba's fallback layer "workqueue" (no OpenMP library on the system) aborts the process when two Python
    threads launch kernels at the same time. There the section is a lock, with OpenMP and TBB it costs
    nothing.
    """
    try:
        concurrent = numba.threading_layer() in _SAFE_FOR_CONCURRENT_CALLERS
    except ValueError:  # no kernel has run yet, so nobody knows
        concurrent = False
    if concurrent:
        yield
        return
    with _section:
        yield


def side_by_side(function: Callable[[A], B], items: Iterable[A]) -> list[B]:
    """What `function` gives for each item, in their order; many small ones at once, each with one thread's kernels.

    A kernel of a millisecond gains nothing by more threads, and what is around it holds Python's lock half the time.
    """
    threads = thread_count()
    if threads == 1:
        return [function(item) for item in items]
    with ThreadPoolExecutor(threads, initializer=numba.set_num_threads, initargs=(1,)) as pool:
        return list(pool.map(function, items))
