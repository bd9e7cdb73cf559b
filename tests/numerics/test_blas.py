"""One BLAS thread inside, whoever overlaps with whom, and the old number again outside."""

from __future__ import annotations

import threading

import numpy as np
from threadpoolctl import threadpool_info

from engine.numerics.blas import one_blas_thread


def threads() -> set[int]:
    np.ones(2) @ np.ones(2)
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_one_thread_inside_and_what_there_was_outside() -> None:
    before = threads()

    @one_blas_thread
    def inside() -> set[int]:
        with one_blas_thread:
            pass
        return threads()

    assert inside() == {1}
    assert threads() == before


def test_the_last_of_several_callers_restores() -> None:
    before, left = threads(), threading.Event()

    def stay() -> None:
        with one_blas_thread:
            left.wait(10)

    other = threading.Thread(target=stay)
    with one_blas_thread:
        other.start()
        while one_blas_thread._inside < 2:
            pass
    assert threads() == {1}
    left.set()
    other.join()
    assert threads() == before
