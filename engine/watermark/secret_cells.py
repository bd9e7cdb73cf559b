"""Cells that only the key knows (DESIGN 4.5): without their borders, displacements cannot be estimated.

The quantizer's cells are public: they follow from the model. They are small, and each copy's key joins them to
code vectors of its own, neighbours only, by a k-d tree whose cuts it draws; it draws how much each one moves, too.
All of that is settled, and bound by the record id, before a chip is drawn from another sub-key.
"""

import numpy as np

from engine.compress.hvq import Stage, group_means
from engine.model import Float64, GaussianModel, Int32
from engine.watermark.keys import CELLS, OwnerKey, uniform

TILT = 0.35
"""How far the key tilts each cut away from the widest feature, standard deviation against 1 along it."""
SLIDE = 0.06
"""How far it slides the cut from the middle, either way, of the node's weight."""
JITTER = 0.3
"""Half width of the keyed factor on each chip's amplitude, as a logarithm."""


def cells_key(key: OwnerKey, asset: bytes, copy: str) -> bytes:
    """The sub-key of one copy's cells; `asset` is the digest of the canonical reference."""
    return key.derive(CELLS, asset + copy.encode())


def join_cells(
    stage: Stage, features: Float64, model: GaussianModel, weights: Float64, count: int, subkey: bytes
) -> Stage:
    """Code vectors of one copy, each of a few neighbouring public cells.

    Parameters
    ----------
    stage : Stage
        The public cells.
    features : (M, D) float64
        Joint features of position and colour of each.
    weights : (N,) float64
        How much an error in each Gaussian's colour is seen.
    count : int
        Code vectors wanted; rounded down to a power of two, at most one for two cells.
    """
    cells = len(stage.codebook)
    seen = np.bincount(stage.labels, weights, cells).astype(np.float64)
    joined = _tree(features, seen + 0.02 * float(seen.mean()) + 1e-300, min(count, cells // 2), subkey)
    labels = joined[stage.labels]
    return Stage(group_means(model.sh.reshape(len(model), -1), labels, weights, int(joined.max()) + 1), labels)


def jitter(subkey: bytes, chips: int) -> Float64:
    """(chips,) factors on the amplitudes, of mean square 1."""
    factors = np.exp(JITTER * (2.0 * uniform(subkey, chips, "jitter") - 1.0))
    return np.asarray(factors / np.sqrt(np.mean(factors**2)))


def _tree(features: Float64, weights: Float64, count: int, subkey: bytes) -> Int32:
    """(M,) leaf of each cell, numbered so that neighbours in number are neighbours in the scene."""
    depth = int(np.log2(max(1, min(count, len(features)))))
    width = features.shape[1]
    drawn = uniform(subkey, (2**depth - 1) * (width + 1), "cuts").reshape(-1, width + 1)
    tilts, slides = np.sqrt(12.0) * TILT * (drawn[:, :width] - 0.5), SLIDE * (2.0 * drawn[:, width] - 1.0)
    node = np.zeros(len(features), dtype=np.int64)
    for level in range(depth):
        nodes = 2**level
        total = np.bincount(node, weights, nodes)
        sums = np.stack([np.bincount(node, weights * column, nodes) for column in features.T], axis=1)
        apart = features - (sums / np.maximum(total, 1e-300)[:, None])[node]
        spread = np.stack([np.bincount(node, weights * column**2, nodes) for column in apart.T], axis=1)
        direction = spread / np.maximum(spread.max(axis=1, keepdims=True), 1e-300)
        direction += tilts[nodes - 1 : 2 * nodes - 1]
        order = np.lexsort(((apart * direction[node]).sum(axis=1), node))
        below = np.cumsum(weights[order]) - weights[order]
        before = np.concatenate([[0.0], np.cumsum(total)[:-1]])
        middle = before + (0.5 + slides[nodes - 1 : 2 * nodes - 1]) * total
        upper = np.empty(len(features), dtype=bool)
        upper[order] = below + 0.5 * weights[order] > middle[node[order]]
        node = 2 * node + upper
    return np.unique(node, return_inverse=True)[1].astype(np.int32)
