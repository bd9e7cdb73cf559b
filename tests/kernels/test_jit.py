"""The numba options: what they must never allow, and how kernels are divided among threads."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys

import numba
import numpy as np
import pytest

from engine.kernels.jit import FLOAT_FLAGS, inlined, kernel, parallel_kernel, share_of
from engine.kernels.thread_crew import use_threads


def test_flags_keep_nan_infinity_and_order() -> None:
    assert not FLOAT_FLAGS & {"nnan", "ninf", "reassoc", "fast"}


def test_a_nan_guard_survives() -> None:
    @kernel
    def repaired(x):
        total = np.float32(0.0)
        for value in x:
            if not np.isnan(value):
                total += value
        return total

    assert repaired(np.array([1.0, np.nan, 2.0], np.float32)) == 3.0


def test_inlined_pieces_and_parallel_loops() -> None:
    @inlined
    def square(x):
        return x * x

    @parallel_kernel
    def squares(x, out, calls, call):
        calls[call[0]] += 1
        for i in share_of(x.shape[0], call):
            out[i] += square(x[i])

    x = np.arange(100.0)
    for run, threads in ((squares, 1), (squares, 3), (squares.py_func, 1)):
        out, calls = np.zeros_like(x), np.zeros(4, np.int64)
        with use_threads(threads):
            run(x, out, calls)
        np.testing.assert_array_equal(out, x * x)
        np.testing.assert_array_equal(calls, np.arange(4) < threads)


def test_shares_are_all_of_it_once_and_even() -> None:
    for count, calls in itertools.product((0, 1, 5, 16, 97), (1, 2, 3, 16)):
        shares = [share_of(count, (number, calls)) for number in range(calls)]
        assert [i for share in shares for i in share] == list(range(count))
        assert max(map(len, shares)) - min(map(len, shares)) <= 1


def test_kernels_make_no_arrays_unless_they_say_so() -> None:
    @kernel(allocates=True)
    def summed(x):
        y = np.zeros(3)
        y[:] = x
        return y.sum()

    @kernel
    def refused(x):
        y = np.zeros(3)
        y[:] = x
        return y.sum()

    assert summed(1.0) == 3.0
    with pytest.raises(numba.core.errors.NumbaError):
        refused(1.0)


def test_idle_workers_sleep() -> None:
    environment = {k: v for k, v in os.environ.items() if k != "OMP_WAIT_POLICY"}
    program = "import engine.kernels.jit, os; print(os.environ['OMP_WAIT_POLICY'])"
    run = [sys.executable, "-c", program]
    assert subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout == "passive\n"
    environment["OMP_WAIT_POLICY"] = "active"  # the user's own choice stands
    assert subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout == "active\n"
