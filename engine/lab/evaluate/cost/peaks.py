"""What this machine can do at most: bytes a second from memory, single-precision operations a second.

McCalpin's triad (STREAM, 1995) for the first, independent chains of fused multiply-adds in registers for the second;
both on the threads the rasterizer uses.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import time
from collections.abc import Callable

import numpy as np

from engine.kernels.jit import parallel_kernel, share_of
from engine.kernels.thread_crew import thread_count
from engine.raster.lane_ir import LANES
from engine.raster.lane_memory import aligned, load, store
from engine.raster.lanes import fma

__all__ = ["peak_bandwidth", "peak_flops"]

CHAINS = 12
"""Chains a thread keeps in flight: more than latency (4 cycles) times ports (2)."""


@parallel_kernel
def _triad(a, b, c, scale, call):
    for i in share_of(a.shape[0], call):
        a[i] = b[i] + scale * c[i]


@parallel_kernel
def _multiply_add(out, rounds, call):
    for worker in share_of(out.shape[0], call):
        own = out[worker]
        times, plus = load(own, 12 * 16), load(own, 13 * 16)
        x0, x1, x2, x3 = load(own, 0), load(own, 16), load(own, 32), load(own, 48)
        x4, x5, x6, x7 = load(own, 64), load(own, 80), load(own, 96), load(own, 112)
        x8, x9, x10, x11 = load(own, 128), load(own, 144), load(own, 160), load(own, 176)
        for _ in range(rounds):
            x0, x1, x2 = fma(x0, times, plus), fma(x1, times, plus), fma(x2, times, plus)
            x3, x4, x5 = fma(x3, times, plus), fma(x4, times, plus), fma(x5, times, plus)
            x6, x7, x8 = fma(x6, times, plus), fma(x7, times, plus), fma(x8, times, plus)
            x9, x10, x11 = fma(x9, times, plus), fma(x10, times, plus), fma(x11, times, plus)
        store(own, 0, x0 + x1 + x2 + x3 + x4 + x5 + x6 + x7 + x8 + x9 + x10 + x11)


def peak_bandwidth(numbers: int = 1 << 25, repeats: int = 5) -> float:
    """Bytes a second of a = b + s c over three float32 arrays of `numbers`, best of `repeats`; 12 bytes a number."""
    a, b, c = (np.full(numbers, value, dtype=np.float32) for value in (0.0, 1.0, 2.0))
    return 12.0 * numbers / _least_seconds(lambda: _triad(a, b, c, np.float32(3.0)), repeats)


def peak_flops(rounds: int = 1 << 22, repeats: int = 5) -> float:
    """Single-precision operations a second of fused multiply-adds on sixteen lanes, each counted as two."""
    out = aligned((thread_count(), (CHAINS + 2) * LANES))
    out[:] = 0.5
    operations = 2.0 * LANES * CHAINS * rounds * len(out)
    return operations / _least_seconds(lambda: _multiply_add(out, rounds), repeats)


def _least_seconds(work: Callable[[], object], repeats: int) -> float:
    """Of several runs after one that compiles: other programs can only make it longer."""
    times = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times[1:])
