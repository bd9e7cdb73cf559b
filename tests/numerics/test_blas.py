"""One BLAS thread inside, however calls overlap, and the old number again outside."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from engine.numerics import wavelet  # noqa: F401 - brings numpy, and so a BLAS
from engine.numerics.blas import one_blas_thread


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    with threadpool_limits(limits=2, user_api="blas"):
        yield


def threads() -> set[int]:
    """Of every BLAS but FAISS's, over OpenMP, where the number is each thread's own."""
    pools = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
    return {pool["num_threads"] for pool in pools if pool.get("threading_layer") != "openmp"}


def test_one_thread_inside_and_what_there_was_outside() -> None:
    assert threads() == {2}

    @one_blas_thread
    def inside() -> set[int]:
        with one_blas_thread:
            pass
        return threads()

    assert inside() == {1}
    assert threads() == {2}


def test_the_last_of_several_callers_restores() -> None:
    left = threading.Event()

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
    assert threads() == {2}
