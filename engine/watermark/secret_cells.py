"""Cells that only the key knows (DESIGN 4.5): without their borders, displacements cannot be estimated.

The quantizer's cells are public: they follow from the model. They are small, and the owner's key joins them to
code vectors of its own, neighbours only, by a k-d tree whose cuts it draws; it draws how much each one moves, too, and
how many times that each Gaussian in it does. All copies of an asset share its cells: cells of a copy's own would give
those who compare copies more equations than unknowns. All of that is settled, and bound by the record id, before a
chip is drawn from another sub-key.
"""

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from engine.compress.hvq import Stage, group_means
from engine.model import Bool, Float32, Float64, GaussianModel, Int32
from engine.watermark.config import CONFIG
from engine.watermark.keys import CELLS, OwnerKey, keystream, uniform

_CONFIG = CONFIG.cells


OWNER, COPIES = "owner", "copies"
"""Whose cells: those of the mark that all copies share, and those on which copies differ. Neither says where the
other's borders are, so what two copies differ in draws no border of the owner's."""


def cells_key(key: OwnerKey, asset: bytes, use: str) -> bytes:
    """The sub-key of one set of cells; `asset` is the digest of the canonical reference."""
    return key.derive(CELLS, asset + f"{use}/1".encode())


def join_cells(
    stage: Stage,
    features: Float64,
    model: GaussianModel,
    weights: Float64,
    count: int,
    subkey: bytes,
    *,
    blurred: bool = False,
) -> Stage:
    """Secret code vectors, each of a few neighbouring public cells.

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
    blurred : bool
        Whether each Gaussian is dealt to one of the `blur` public cells around it, so that no border can be seen in
        how neighboring Gaussians are displaced.
    """
    cells = len(stage.codebook)
    seen = np.bincount(stage.labels, weights, cells).astype(np.float64)
    joined = _tree(features, seen + 0.02 * float(seen.mean()) + 1e-300, min(count, cells // 2), subkey)
    public = stage.labels
    if blurred:
        tree = scipy.spatial.cKDTree(features)
        near = tree.query(features, k=min(_CONFIG.blur, cells), workers=2)[1].reshape(cells, -1)
        dealt = keystream(subkey, len(public), "blur") % np.uint8(near.shape[1])
        public = near[public, dealt]
    labels = np.unique(joined[public], return_inverse=True)[1].astype(np.int32)
    return Stage(group_means(model.sh.reshape(len(model), -1), labels, weights, int(labels.max()) + 1), labels)


GRID = 512.0
"""Values are compared in steps of 1/512, as the reference keeps them."""
AROUND = 3
"""Values on either side that say how many Gaussians have a usual one."""


def find_masses(dc: Float32, share: float) -> Bool:
    """(N,) Gaussians with a DC value, in any channel, that more than this share of all have, and far more than have the
    values around it; none where most would.

    On real scenes up to half of all have a channel at pure white or black: a histogram would show a mark that tears
    such a mass apart. The others carry a little more for the same PSNR. What many have because values are few is moved:
    held, it would show.
    """
    still: Bool = np.zeros(len(dc), dtype=np.bool_)
    for channel in np.round(GRID * dc.astype(np.float64)).astype(np.int64).T:
        _, place, count = np.unique(channel, return_inverse=True, return_counts=True)
        around = sliding_window_view(np.pad(count, AROUND, mode="reflect"), 2 * AROUND + 1)
        usual = np.median(around, axis=-1)
        still |= ((count > share * len(dc)) & (count > CONFIG.planning.mass_factor * usual))[place]
    return still if still.mean() <= CONFIG.planning.most_still else np.zeros_like(still)


def multiples(subkey: bytes, still: Bool) -> Float32:
    """(N,) how many times its code vectors' displacements each Gaussian takes: 0 for those that hold `still`, else
    evenly from 0.5 to 1.5, over the root of their mean square; in steps that a record keeps in a byte."""
    drawn = keystream(subkey, len(still), "multiples").astype(np.float32)
    steps = np.where(still, np.float32(0.0), np.round(64.0 + drawn * np.float32(128.0 / 255.0)))
    return np.asarray(steps * MULTIPLE, dtype=np.float32)


MULTIPLE = np.float32(1.0 / (128.0 * np.sqrt(13.0 / 12.0)))
"""Step in which a record keeps a Gaussian's multiple."""


def jitter(subkey: bytes, chips: int) -> Float64:
    """(chips,) factors on the amplitudes, of mean square 1."""
    factors = np.exp(_CONFIG.jitter * (2.0 * uniform(subkey, chips, "jitter") - 1.0))
    return np.asarray(factors / np.sqrt(np.mean(factors**2)))


def _tree(features: Float64, weights: Float64, count: int, subkey: bytes) -> Int32:
    """(M,) leaf of each cell, numbered so that neighbours in number are neighbours in the scene."""
    depth = int(np.log2(max(1, min(count, len(features)))))
    width = features.shape[1]
    drawn = uniform(subkey, (2**depth - 1) * (width + 1), "cuts").reshape(-1, width + 1)
    tilts = np.sqrt(12.0) * _CONFIG.tilt * (drawn[:, :width] - 0.5)
    slides = _CONFIG.slide * (2.0 * drawn[:, width] - 1.0)
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
