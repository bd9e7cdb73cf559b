"""The numba options: what they must never allow, and the guard for thread layers."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import numba
import numpy as np
import pytest

from engine.numerics import jit
from engine.numerics.jit import FLOAT_FLAGS, inlined, kernel, parallel_kernel, parallel_section, thread_count


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
    def squares(x, out):
        for i in numba.prange(x.shape[0]):
            out[i] = square(x[i])

    x = np.arange(100.0)
    out = np.empty_like(x)
    with parallel_section():
        squares(x, out)
    np.testing.assert_array_equal(out, x * x)
    assert thread_count() == numba.get_num_threads()


def test_idle_workers_sleep() -> None:
    environment = {k: v for k, v in os.environ.items() if k != "OMP_WAIT_POLICY"}
    program = "import engine.numerics.jit, os; print(os.environ['OMP_WAIT_POLICY'])"
    run = [sys.executable, "-c", program]
    assert subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout == "passive\n"
    environment["OMP_WAIT_POLICY"] = "active"  # the user's own choice stands
    assert subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout == "active\n"


@pytest.mark.parametrize("layer", ["workqueue", "omp"])
def test_section_locks_only_where_it_must(monkeypatch: pytest.MonkeyPatch, layer: str) -> None:
    monkeypatch.setattr(jit.numba, "threading_layer", lambda: layer)
    entered = threading.Event()

    def other() -> None:
        with parallel_section():
            entered.set()

    with parallel_section():
        thread = threading.Thread(target=other)
        thread.start()
        assert entered.wait(0.2 if layer == "workqueue" else 5.0) == (layer == "omp")
    thread.join()
    assert entered.is_set()
