"""The numba options of the whole program, in one place, and how kernels are divided among threads.

No option set here carries the no-NaN or no-infinity flags: with full ``fastmath`` an ``isnan`` guard silently
vanishes. Nor does any carry ``reassoc``: it lets LLVM cancel the magic constant of the exponential's range
reduction (measured: 35 dB images).

Kernels make no arrays unless they say so (``allocates``): then numba counts no references either, which it otherwise
does at every call of an inlined function (measured: half of the time of a loop that calls one).

Numba's disk cache looks at the date of the file that defines a kernel, not at what that file imports. So
every file of kernels holds a ``_KERNEL_VERSION``; raise it when something the kernels import has changed.
"""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numba
from numba.extending import register_jitable

from engine.numerics.crew import run_turns, thread_count, use_threads

__all__ = ["FLOAT_FLAGS", "ParallelKernel", "inlined", "kernel", "parallel_kernel", "share_of", "side_by_side"]

FLOAT_FLAGS = frozenset({"nsz", "arcp", "contract", "afn"})
"""Floating-point freedoms given to LLVM: signed zeros, reciprocals, fused multiply-add, approximate
functions."""

_INLINED: dict[str, Any] = {
    "boundscheck": False,
    "error_model": "numpy",  # no division-by-zero checks: they stop vectorization
    "fastmath": set(FLOAT_FLAGS),
}
_OPTIONS: dict[str, Any] = {**_INLINED, "cache": True, "nogil": True}

A = TypeVar("A")
B = TypeVar("B")


def kernel(function: Callable[..., Any] | None = None, *, allocates: bool = False) -> Any:
    """Compile a single-threaded kernel."""
    compiled = numba.njit(_nrt=allocates, **_OPTIONS)
    return compiled if function is None else compiled(function)


def inlined(function: Callable[..., Any] | None = None, *, allocates: bool = False) -> Any:
    """Compile a piece of a kernel that LLVM inlines wherever it is called."""
    compiled = numba.njit(forceinline=True, _nrt=allocates, **_INLINED)
    return compiled if function is None else compiled(function)


def parallel_kernel(function: Callable[..., Any] | None = None, *, allocates: bool = False) -> Any:
    """Compile a kernel that threads run side by side. Its last parameter is `call`, which callers leave out: the number
    of the call and how many there are; what it loops over by `share_of` is divided among the calls. It returns
    nothing."""
    if function is None:
        return lambda given: ParallelKernel(given, allocates)
    return ParallelKernel(function, allocates)


@register_jitable(forceinline=True)
def share_of(count, call):  # type: ignore[no-untyped-def]  # of kernels
    """The part of range(count) that belongs to one of the calls of a parallel kernel: contiguous, as even as can be."""
    return range(count * call[0] // call[1], count * (call[0] + 1) // call[1])


class ParallelKernel:
    """What `parallel_kernel` makes: called without `call`, it runs on `thread_count` threads."""

    def __init__(self, function: Callable[..., Any], allocates: bool) -> None:
        self.one_turn: Any = kernel(function, allocates=allocates)
        self.__doc__, self.__name__, self.__module__ = function.__doc__, function.__name__, function.__module__

    def __call__(self, *arguments: Any, turns: int | None = None) -> None:
        """Run it; `turns` for another number of threads."""
        turns = turns or thread_count()
        run_turns(lambda number: self.one_turn(*arguments, (number, turns)), turns)

    def py_func(self, *arguments: Any) -> None:
        """The same, not compiled and in one turn."""
        self.one_turn.py_func(*arguments, (0, 1))


def side_by_side(function: Callable[[A], B], items: Iterable[A]) -> list[B]:
    """What `function` gives for each item, in their order; many small ones at once, each with one thread's kernels.

    A kernel of a millisecond gains nothing by more threads, and what is around it holds Python's lock half the time.
    """

    asked, answers = list(items), dict[int, B]()

    def alone(number: int) -> None:
        with use_threads(1):
            answers[number] = function(asked[number])

    run_turns(alone, len(asked), thread_count())
    return [answers[number] for number in range(len(asked))]
