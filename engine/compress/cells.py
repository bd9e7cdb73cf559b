"""Stage 0 of the vector quantiser: cells compact in position and colour (DESIGN 4.4).

A balanced k-d tree over the joint features (position, DC colour), split at the *weighted* median of the widest
feature. A Gaussian weighs as much as an error in its colour would show in the key views (sum of w^2): every cell then
shows about as much, so every chip and every bit gets about the same evidence. No k-means is needed.
"""

import numpy as np

from engine.compress.config import CONFIG
from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.model import Float32, Float64, GaussianModel, Int32


@inlined
def _widest_feature(features, weights, order, begin, end, total):  # type: ignore[no-untyped-def]
    """The feature with the largest weighted variance over rows order[begin:end], which weigh `total`."""
    best, widest = 0, -1.0
    for d in range(features.shape[1]):
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
    return best


@parallel_kernel
def _split_level(features, weights, order, starts, keys, masses, scratch, cuts, call):  # type: ignore[no-untyped-def]
    """Split every node [starts[k], starts[k+1]) of `order` at its weighted median along its widest feature. Both halves
    keep the order of the file, in which equal ones are dealt out, too. Keys, masses and scratch (N,) are its own."""
    for k in share_of(len(starts) - 1, call):
        begin, end = starts[k], starts[k + 1]
        if end - begin < 2:
            cuts[k] = end
            continue
        total = 0.0
        for j in range(begin, end):
            total += weights[order[j]]
        best = _widest_feature(features, weights, order, begin, end, total)
        for j in range(begin, end):
            keys[j], masses[j] = features[order[j], best], weights[order[j]]
        median, below = _weighted_median(keys, masses, begin, end, 0.5 * total)
        low, high, last = begin, 0, -1
        for j in range(begin, end):
            key = features[order[j], best]
            if key < median or (key == median and below < 0.5 * total):
                if key == median:
                    below, last = below + weights[order[j]], low
                order[low] = order[j]
                low += 1
            else:
                scratch[begin + high] = order[j]
                high += 1
        if high == 0:  # one that outweighs all others is the greatest: it is a half by itself
            scratch[begin], high, low = order[last], 1, low - 1
            for j in range(last, low):
                order[j] = order[j + 1]
        for j in range(high):
            order[low + j] = scratch[begin + j]
        cuts[k] = low


@inlined
def _weighted_median(keys, masses, begin, end, half):  # type: ignore[no-untyped-def]
    """The key at which the masses of [begin, end), in the order of their keys, reach `half`; and the mass of all that
    are smaller. Reorders both, as Hoare's quickselect does."""
    below, draw = 0.0, 1
    while end - begin > 1:
        draw = (draw * 1103515245 + 12345) & 0x7FFFFFFF  # no order of the file is a slow one
        a, b, c = keys[begin + draw % (end - begin)], keys[(begin + end) >> 1], keys[end - 1]
        pivot = max(min(a, b), min(max(a, b), c))
        smaller, j, greater = begin, begin, end  # three heaps: below the pivot, equal to it, above
        mass, equal = 0.0, 0.0
        while j < greater:
            key = keys[j]
            if key < pivot:
                mass += masses[j]
                keys[j], keys[smaller] = keys[smaller], key
                masses[j], masses[smaller] = masses[smaller], masses[j]
                smaller += 1
                j += 1
            elif key > pivot:
                greater -= 1
                keys[j], keys[greater] = keys[greater], key
                masses[j], masses[greater] = masses[greater], masses[j]
            else:
                equal += masses[j]
                j += 1
        if below + mass >= half:
            end = smaller
        elif below + mass + equal >= half or greater == end:
            return pivot, below + mass
        else:
            below += mass + equal
            begin = greater
    return keys[begin], below


def cell_features(model: GaussianModel, radius: float) -> Float32:
    """(N, 6) joint features: position in scene radii and DC color times its weight."""
    return np.concatenate([model.means / radius, model.sh[:, 0] * CONFIG.color_weight], axis=1).astype(np.float32)


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
    keys, masses, scratch = np.empty(n, np.float32), np.empty(n), np.empty(n, np.int64)
    for _ in range(depth):
        cuts = np.empty(len(starts) - 1, dtype=np.int64)
        _split_level(features, weights, order, starts, keys, masses, scratch, cuts)
        starts = np.unique(np.concatenate([starts, cuts]))
    labels = np.empty(n, dtype=np.int32)
    labels[order] = np.repeat(np.arange(len(starts) - 1, dtype=np.int32), np.diff(starts))
    return labels
