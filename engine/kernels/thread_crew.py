"""Threads that take turns at one piece of work: how parallel kernels run.

Numba's own parallel loops would do the same, but compile each kernel twice over and need a library of the system
(OpenMP) for more than one caller at a time. A turn here is an ordinary call of a compiled kernel, without Python's
lock.
"""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from queue import SimpleQueue
from typing import Any

# Torch's idle OpenMP workers sleep, not spin: while kernels run, spinning costs 2 to 20 times on a busy machine.
# It must be set before torch starts its pool.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

_own = threading.local()


def usable_cores() -> int:
    """Those that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def thread_count() -> int:
    """How many threads a parallel kernel uses when this thread calls it; all that NUMBA_NUM_THREADS allows (by default
    one for each core) unless `use_threads` says otherwise."""
    return getattr(_own, "count", None) or _allowed()


@cache
def _allowed() -> int:
    try:
        limit = int(os.environ.get("NUMBA_NUM_THREADS", "0"))
    except ValueError:
        limit = 0
    return limit if limit > 0 else usable_cores()


@contextmanager
def use_threads(count: int) -> Iterator[None]:
    """So many threads for the kernels that this thread calls in the block."""
    before = getattr(_own, "count", None)
    _own.count = count
    try:
        yield
    finally:
        _own.count = before


class _Launch:
    """One piece of work: its turns are claimed one by one, each by the next free thread."""

    def __init__(self, turn: Callable[[int], object], turns: int) -> None:
        self._turn, self._left = turn, iter(range(turns))
        self._undone = turns
        self._lock = threading.Lock()
        self._done = threading.Event()
        self.failed: BaseException | None = None

    def help(self) -> None:
        """Take turns until none is left."""
        for number in self._left:  # a step of this iterator holds Python's lock: no number is given twice
            try:
                self._turn(number)
            except BaseException as error:
                self.failed = error
            with self._lock:
                self._undone -= 1
                if self._undone == 0:
                    self._done.set()

    def wait(self) -> None:
        """Until the last turn is over, whatever interrupts: turns write to arrays of the caller."""
        try:
            self._done.wait()
        except BaseException:
            self._done.wait()
            raise


class _Crew:
    def __init__(self) -> None:
        self._calls: SimpleQueue[_Launch] = SimpleQueue()
        self._size, self._lock = 0, threading.Lock()

    def call(self, launch: _Launch, helpers: int) -> None:
        """Ask for help; the caller needs none to get done."""
        with self._lock:
            while self._size < helpers:
                threading.Thread(target=self._serve, daemon=True).start()
                self._size += 1
        for _ in range(helpers):
            self._calls.put(launch)

    def _serve(self) -> None:
        while True:
            self._calls.get().help()


_crew = _Crew()


def _forget() -> None:
    global _crew
    _crew = _Crew()  # threads do not live on in a forked process


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


def run_turns(turn: Callable[[int], Any], turns: int, threads: int | None = None) -> None:
    """Call turn(0) to turn(turns - 1), side by side, each on a thread of its own or on so many `threads`; what a turn
    raises is raised once all are over."""
    if turns <= 1:
        for number in range(turns):
            turn(number)
        return
    launch = _Launch(turn, turns)
    _crew.call(launch, min(turns, threads or turns) - 1)
    launch.help()
    launch.wait()
    if launch.failed is not None:
        raise launch.failed
