"""Stage 0 of the vector quantiser: cells compact in position and colour (DESIGN 4.4).

A balanced k-d tree over the joint features (position, DC colour), split at the *weighted* median of the widest
feature. A Gaussian weighs as much as an error in its colour would show in the key views (sum of w^2): every cell then
shows about as much, so every chip and every bit gets about the same evidence. No k-means is needed.
"""

import numpy as np

from engine.model import Float32, Float64, GaussianModel, Int32
from engine.numerics.jit import parallel_kernel, share_of

COLOR_WEIGHT = 0.06
"""Weight of a unit of DC colour against a unit of the scene's radius in the split rule."""

_KERNEL_VERSION = 2  # numba's cache looks at this file only


@parallel_kernel(allocates=True)
def _split_level(features, weights, order, starts, scratch, cuts, call):  # type: ignore[no-untyped-def]
    """Split every node [starts[k], starts[k+1]) of `order` at its weighted median along its widest feature."""
    dims = features.shape[1]
    for k in share_of(len(starts) - 1, call):
        begin, end = starts[k], starts[k + 1]
        count = end - begin
        if count < 2:
            cuts[k] = end
            continue
        total = 0.0
        for j in range(begin, end):
            total += weights[order[j]]
        best, widest = 0, -1.0
        for d in range(dims):
            mean = 0.0
            for j in range(begin, end):
                mean += weights[order[j]] * features[order[j], d]
            mean /= total
            spread = 0.0
            for j in range(begin, end):
                gap = features[order[j], d] - mean
                spread += weights[order[j]] * gap * gap
            if spread > widest:
                widest, best = spread, d
        keys = np.empty(count, np.float32)
        for j in range(count):
            keys[j] = features[order[begin + j], best]
        rank = np.argsort(keys, kind="mergesort")  # stable: ties keep file order, so the tree is reproducible
        for j in range(count):
            scratch[begin + j] = order[begin + rank[j]]
        half, running, cut = 0.5 * total, 0.0, begin + 1
        for j in range(begin, end):
            order[j] = scratch[j]
            running += weights[scratch[j]]
            if running < half:
                cut = j + 2
        cuts[k] = min(max(cut, begin + 1), end - 1)


def cell_features(model: GaussianModel, radius: float) -> Float32:
    """(N, 6) joint features: position in scene radii and DC colour times COLOR_WEIGHT."""
    return np.concatenate([model.means / radius, model.sh[:, 0] * COLOR_WEIGHT], axis=1).astype(np.float32)


def split_cells(features: Float32, weights: Float64, count: int) -> Int32:
    """Cell of each Gaussian.

    Parameters
    ----------
    features : (N, D) float32
        Joint features of position and colour.
    weights : (N,) float64
        How much each Gaussian shows in the images; a floor keeps unseen ones from sharing one cell.
    count : int
        Number of cells wanted; rounded down to a power of two, and at most N.

    Returns
    -------
    labels : (N,) int32
        0 .. cells-1; every cell has at least one member.
    """
    n = len(features)
    depth = int(np.log2(max(1, min(count, n))))
    floor = 0.02 * float(weights.mean()) + 1e-12
    weights = np.ascontiguousarray(weights, dtype=np.float64) + floor
    features = np.ascontiguousarray(features, dtype=np.float32)
    order = np.arange(n, dtype=np.int64)
    starts = np.array([0, n], dtype=np.int64)
    scratch = np.empty(n, dtype=np.int64)
    for _ in range(depth):
        cuts = np.empty(len(starts) - 1, dtype=np.int64)
        _split_level(features, weights, order, starts, scratch, cuts)
        starts = np.unique(np.concatenate([starts, cuts]))
    labels = np.empty(n, dtype=np.int32)
    labels[order] = np.repeat(np.arange(len(starts) - 1, dtype=np.int32), np.diff(starts))
    return labels
