"""Compiled kernels: their options, in one place, and how they are divided among threads.

No option set here carries the no-NaN or no-infinity flags: with full ``fastmath`` an ``isnan`` guard silently
vanishes. Nor does any carry ``reassoc``: it lets LLVM cancel the magic constant of the exponential's range
reduction (measured: 35 dB images).

Kernels make no arrays unless they say so (``allocates``): then numba counts no references either, which it otherwise
does at every call of an inlined function (measured: half of the time of a loop that calls one). And then their machine
code stands alone: it is kept and called without numba (`machine_code`), which is imported only to compile.

Those that do make arrays are numba's to keep, in folders of `kernel_cache`. All are numba's where its machine code must
not be called (`native_check`).
"""

import threading
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from engine.kernels import kernel_cache, machine_code
from engine.kernels.deferred import Deferred, resolved, text_of
from engine.kernels.thread_crew import run_turns, thread_count, use_threads

FLOAT_FLAGS = frozenset({"nsz", "arcp", "contract", "afn"})
"""Floating-point freedoms given to LLVM: signed zeros, reciprocals, fused multiply-add, approximate
functions."""

A = TypeVar("A")
B = TypeVar("B")


class Kernel(Deferred):
    """What `kernel` makes: compiled at the first call with arguments of new types. What other kernels call of it is
    numba's own callable."""

    def __init__(self, function: Callable[..., Any], allocates: bool = False) -> None:
        super().__init__(function, self._make_numbas)
        self._allocates = allocates
        self._label = f"{self.__module__}.{self.__name__}"
        self._natives: dict[str, machine_code.Native | None] = {}  # None where numba must run it
        self._lock = threading.Lock()

    def py_func(self, *arguments: Any) -> Any:
        """The same, not compiled."""
        return self.function(*arguments)

    @property
    def signatures(self) -> list[str]:
        """Types of arguments for which there is code by now."""
        return [*self._natives, *map(str, self._compiled.signatures if self._compiled is not None else ())]

    def __call__(self, *arguments: Any) -> Any:
        """Run it."""
        code = self._code(arguments)
        return self.compiled()(*arguments) if code is None else code(*machine_code.flatten(arguments, []))

    def _code(self, arguments: tuple[Any, ...]) -> machine_code.Native | None:
        """Machine code for such arguments; None where numba must run it."""
        kinds = None if self._allocates else machine_code.kind_of(arguments)
        if kinds is None:
            return None
        if kinds not in self._natives:
            with self._lock:
                if kinds not in self._natives:
                    self._natives[kinds] = self._made(kinds, arguments)
        return self._natives[kinds]

    def _made(self, kinds: str, arguments: tuple[Any, ...]) -> machine_code.Native | None:
        from engine.kernels.native_check import calls_native

        if not calls_native():
            return None
        label, text = self._label, text_of(self.function)
        code = kernel_cache.find(label, text, kinds)
        if code is None:
            machine_code.announce()
            from engine.kernels.compiler import compile_kernel

            code = compile_kernel(resolved(self.function), FLOAT_FLAGS, arguments)
            if code is None:
                return None
            kernel_cache.keep(label, text, kinds, code)
        return machine_code.load(code)

    def _make_numbas(self) -> Any:
        from engine.kernels.compiler import dispatcher
        from engine.kernels.native_check import calls_native

        keeps = self._allocates or not calls_native()
        place = kernel_cache.numba_folder(self._label, text_of(self.function)) if keeps else None
        return dispatcher(resolved(self.function), FLOAT_FLAGS, self._allocates, place)


def kernel(function: Callable[..., Any] | None = None, *, allocates: bool = False) -> Any:
    """Compile a single-threaded kernel."""
    if function is None:
        return lambda given: Kernel(given, allocates)
    return Kernel(function, allocates)


def inlined(function: Callable[..., Any] | None = None, *, allocates: bool = False) -> Any:
    """A piece of a kernel that LLVM inlines wherever it is called."""

    def make(given: Callable[..., Any]) -> Deferred:
        def compiled() -> Any:
            from engine.kernels.compiler import inlined_function

            return inlined_function(resolved(given), FLOAT_FLAGS, allocates)

        return Deferred(given, compiled, (allocates,))

    return make if function is None else make(function)


def parallel_kernel(function: Callable[..., Any] | None = None, *, allocates: bool = False) -> Any:
    """Compile a kernel that threads run side by side. Its last parameter is `call`, which callers leave out: the number
    of the call and how many there are; what it loops over by `share_of` is divided among the calls. It returns
    nothing."""
    if function is None:
        return lambda given: ParallelKernel(given, allocates)
    return ParallelKernel(function, allocates)


def _deferred_share_of(count, call):  # type: ignore[no-untyped-def]  # of kernels
    """The part of range(count) that belongs to one of the calls of a parallel kernel: contiguous, as even as can be."""
    return range(count * call[0] // call[1], count * (call[0] + 1) // call[1])


def _compiled_share_of() -> Any:
    from engine.kernels.compiler import plain_function

    return plain_function(_deferred_share_of)


share_of: Any = Deferred(_deferred_share_of, _compiled_share_of)


class ParallelKernel(Kernel):
    """What `parallel_kernel` makes: called without `call`, it runs on `thread_count` threads."""

    def py_func(self, *arguments: Any) -> None:
        """The same, not compiled and in one turn."""
        self.function(*arguments, (0, 1))

    def __call__(self, *arguments: Any, turns: int | None = None) -> None:
        """Run it; `turns` for another number of threads."""
        turns = turns or thread_count()
        code = self._code((*arguments, (0, turns)))
        if code is None:
            run = self.compiled()
            run_turns(lambda number: run(*arguments, (number, turns)), turns)
        else:
            given = machine_code.flatten(arguments, [])
            run_turns(lambda number: code(*given, number, turns), turns)


def side_by_side(function: Callable[[A], B], items: Iterable[A]) -> list[B]:
    """What `function` gives for each item, in their order; many small ones at once, each with one thread's kernels.

    A kernel of a millisecond gains nothing by more threads, and what is around it holds Python's lock half the time.
    """

    given, answers = list(items), dict[int, B]()

    def answer(number: int) -> None:
        with use_threads(1):
            answers[number] = function(given[number])

    run_turns(answer, len(given), thread_count())
    return [answers[number] for number in range(len(given))]
