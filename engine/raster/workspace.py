"""Scratch memory that outlives a call, without being shared between threads.

A rasterizer call borrows a whole workspace; two calls at the same time get two. Reuse matters: fresh pages
cost more than the passes that fill them.
"""

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.kernels.thread_crew import thread_count
from engine.raster.lane_memory import aligned
from engine.raster.tiles import ITEMS

_KEPT = 2
_MOST = 512 << 20
"""Bytes of a workspace above which it is not kept: to fill fresh memory then costs little next to what fills it."""

_lock = threading.Lock()
_idle: "list[Workspace]" = []


class Workspace:
    """Named arrays that grow as needed; their content is whatever the last user left."""

    def __init__(self) -> None:
        self._arrays: dict[str, npt.NDArray[Any]] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
        """The array of that name, cache-line aligned, uninitialised."""
        size = math.prod(shape)
        have = self._arrays.get(name)
        if have is None or have.size < size or have.dtype != np.dtype(dtype):
            self._arrays.pop(name, None)
            have = aligned((size + size // 8,), dtype)
            self._arrays[name] = have
        return have[:size].reshape(shape)

    @property
    def bytes(self) -> int:
        """What it holds."""
        return sum(array.nbytes for array in self._arrays.values())

    def tile_bench(self, numbers: int) -> tuple[Any, ...]:
        """What the workers of a pass over tiles write to: scratch of so many floats each, a list of items each, and
        the queue of tiles that they share, at its start."""
        workers = thread_count()
        scratch, items = self.array("tile scratch", (workers, numbers)), self.array("items", (workers, ITEMS), np.int32)
        queue = self.array("queue", (1,), np.int64)
        queue[0] = 0
        return scratch, items, queue


@contextmanager
def borrow_workspace() -> Iterator[Workspace]:
    """A workspace for this call alone until the block ends."""
    with _lock:
        workspace = _idle.pop() if _idle else Workspace()
    try:
        yield workspace
    finally:
        with _lock:
            if len(_idle) < _KEPT and workspace.bytes <= _MOST:
                _idle.append(workspace)


def release_memory() -> None:
    """Give the idle scratch memory back (some 100 bytes a Gaussian and 20 to 70 a pair, after a large
    scene)."""
    with _lock:
        _idle.clear()
