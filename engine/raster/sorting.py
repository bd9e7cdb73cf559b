"""Pass 2: visible Gaussians front to back, by a stable radix sort of their depths.

Depths are positive, so their bits sort like the numbers. Chunks arrive in model order and every pass is
stable: equal depths keep the model's order, whatever the number of threads. A key and what it belongs to move as one
number, so that a bucket is one stream of writes.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from engine.kernels.jit import parallel_kernel, share_of
from engine.kernels.thread_crew import thread_count
from engine.model import Int32, Int64

__all__ = ["BUCKETS", "sort_by_depth", "workers_for"]


_BITS = 11
BUCKETS = 1 << _BITS
_WORTH_A_THREAD = 1 << 15
"""Gaussians below which a second thread takes longer to be called than to help."""
_LOW = np.uint64(BUCKETS - 1)
_HALF = np.uint64(32)
_INDEX = np.uint64(0xFFFFFFFF)


def workers_for(n: int) -> int:
    """How many threads sort n Gaussians best."""
    return min(thread_count(), max(1, n // _WORTH_A_THREAD))


def sort_by_depth(
    depth_bits: npt.NDArray[np.uint32],
    index: Int32,
    counts: Int64,
    chunk: int,
    keys: Sequence[npt.NDArray[np.uint64]],
    order: Int32,
    histograms: Sequence[Int64],
) -> int:
    """Sort the compact stretches that `project` wrote.

    Parameters
    ----------
    depth_bits : (N,) uint32, index : (N,) int32, counts : (chunks,), chunk : see `project`
    keys : two (N,) uint64, scratch
    order : (N,) int32, out
    histograms : two (workers, BUCKETS) int64, scratch

    Returns
    -------
    int
        Number of visible Gaussians V; their indices, nearest first, stand in ``order[:V]``.
    """
    here, there = keys
    starts = np.concatenate([[0], np.cumsum(counts)])
    n, workers = int(starts[-1]), len(histograms[0])
    pack_keys(depth_bits, index, counts, starts, chunk, here)
    for digit in range(3):
        count_digits(here, n, digit, histograms[0], turns=workers)
        move_keys(here, n, digit, *histograms, there, order, turns=workers)
        here, there = there, here
    return n


@parallel_kernel
def pack_keys(depth_bits, index, counts, starts, chunk, keys, call):
    """Depth and index of every visible Gaussian as one number, without the gaps between the stretches."""
    for part in share_of(counts.shape[0], call):
        at = starts[part]
        for j in range(counts[part]):
            keys[at + j] = (np.uint64(depth_bits[part * chunk + j]) << _HALF) | np.uint64(index[part * chunk + j])


@parallel_kernel
def count_digits(keys, n, digit, histograms, call):
    """How often each value of one of the three digits comes in each worker's share of the first n keys."""
    workers = histograms.shape[0]
    share = (n + workers - 1) // workers
    shift = np.uint64(_BITS * digit) + _HALF
    for w in share_of(workers, call):
        own = histograms[w]
        for bucket in range(BUCKETS):
            own[bucket] = 0
        for j in range(w * share, min(n, (w + 1) * share)):
            own[(keys[j] >> shift) & _LOW] += 1


@parallel_kernel
def move_keys(keys, n, digit, histograms, places, moved, order, call):
    """Keys in the order of a digit, after those of their bucket that come before them; of the last digit the indices
    alone, to `order`. `places` is scratch like `histograms`."""
    workers = histograms.shape[0]
    share = (n + workers - 1) // workers
    shift = np.uint64(_BITS * digit) + _HALF
    for w in share_of(workers, call):
        own = places[w]
        total = 0
        for bucket in range(BUCKETS):
            for other in range(workers):
                if other == w:
                    own[bucket] = total
                total += histograms[other, bucket]
        for j in range(w * share, min(n, (w + 1) * share)):
            bucket = (keys[j] >> shift) & _LOW
            to = own[bucket]
            own[bucket] = to + 1
            if digit < 2:
                moved[to] = keys[j]
            else:
                order[to] = np.int32(keys[j] & _INDEX)
