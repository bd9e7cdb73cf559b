"""The same answer on any number of threads: computed once with one, once with two."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from engine.kernels.thread_crew import use_threads

T = TypeVar("T")


def with_one_and_two_threads(answer: Callable[[], T]) -> tuple[T, T]:
    """What a function answers where kernels may use one thread, and where they may use two."""
    with use_threads(1):
        one = answer()
    with use_threads(2):
        return one, answer()
