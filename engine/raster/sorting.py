"""Pass 2: visible Gaussians front to back, by a stable radix sort of their depths.

Depths are positive, so their bits sort like the numbers. Chunks arrive in model order and every pass is
stable: equal depths keep the model's order, whatever the number of threads.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import numpy as np
from numba import prange

from engine.numerics.jit import parallel_kernel

__all__ = ["BUCKETS", "sort_by_depth"]

_KERNEL_VERSION = 1

_BITS = 11
BUCKETS = 1 << _BITS
_LOW = np.uint32(BUCKETS - 1)


@parallel_kernel
def sort_by_depth(depth_bits, index, counts, chunk, keys_a, keys_b, order_a, order_b, histograms):
    """Sort the compact stretches that `project` wrote.

    Parameters
    ----------
    depth_bits : (N,) uint32, index : (N,) int32, counts : (chunks,), chunk : see `project`
    keys_a, keys_b : (N,) uint32 and order_a, order_b : (N,) int32, scratch
    histograms : (workers, BUCKETS) int64 scratch

    Returns
    -------
    int
        Number of visible Gaussians V; their indices, nearest first, stand in ``order_b[:V]`` (three passes).
    """
    starts = np.zeros(counts.shape[0] + 1, np.int64)
    for part in range(counts.shape[0]):
        starts[part + 1] = starts[part] + counts[part]
    n = starts[-1]
    for part in prange(counts.shape[0]):
        at = starts[part]
        for j in range(counts[part]):
            keys_a[at + j] = depth_bits[part * chunk + j]
            order_a[at + j] = index[part * chunk + j]
    workers = histograms.shape[0]
    share = (n + workers - 1) // workers
    for digit in range(3):
        shift = np.uint32(_BITS * digit)
        for w in prange(workers):
            own = histograms[w]
            for bucket in range(BUCKETS):
                own[bucket] = 0
            for j in range(w * share, min(n, (w + 1) * share)):
                own[(keys_a[j] >> shift) & _LOW] += 1
        total = 0
        for bucket in range(BUCKETS):
            for w in range(workers):
                size = histograms[w, bucket]
                histograms[w, bucket] = total
                total += size
        for w in prange(workers):
            own = histograms[w]
            for j in range(w * share, min(n, (w + 1) * share)):
                bucket = (keys_a[j] >> shift) & _LOW
                to = own[bucket]
                own[bucket] = to + 1
                keys_b[to] = keys_a[j]
                order_b[to] = order_a[j]
        keys_a, keys_b = keys_b, keys_a
        order_a, order_b = order_b, order_a
    return n
