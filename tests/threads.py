"""The same answer on any number of threads: asked for once with one, once with two."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba
import pytest

T = TypeVar("T")


def with_one_and_two_threads(answer: Callable[[], T]) -> tuple[T, T]:
    """What a function answers where numba's kernels may use one thread, and where they may use two."""
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("NUMBA_NUM_THREADS=1 leaves nothing to compare")
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = answer()
        numba.set_num_threads(2)
        return one, answer()
    finally:
        numba.set_num_threads(before)
