"""What a stranger can measure on the colours of a model, region by region, without the key.

A mark moves DC colours by little, but in patches and along few directions; and it may break the lattice of values
that a file format left. The features here see both: how a Gaussian's colour stands to its neighbours' at three sizes,
how values are distributed, and how often exactly the same value occurs.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from engine.model import SH_C0, Float64, GaussianModel, Int64

__all__ = ["Regions", "divide", "float_born", "measure_regions"]

REGION = 512
"""About so many Gaussians a region."""
NEAR, FAR = 8, 48
"""Neighbours: the nearest, and about as many as share a code vector of the coarsest stage."""
OFTEN = 4
"""Occurrences of a value that floating point does not give by chance."""
LONGEST_TAIL = 0.5
"""Mean of what was clipped beyond an end of a format's range, DC units: a seventh of black to white."""
EDGES = np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])
OPPONENT = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 0.0], [0.5, 0.5, -1.0]]) / np.sqrt([[3.0], [2.0], [1.5]])
"""Lightness and two colour differences."""


@dataclass(frozen=True, eq=False)
class Regions:
    """Compact pieces of one geometry and who is whose neighbour; the same for all copies of a scene."""

    label: Int64  # (N,) region of each Gaussian
    count: int
    neighbors: Int64  # (N, FAR) nearest first


def divide(model: GaussianModel) -> Regions:
    """Halve the longest side at its median until pieces have about 512 Gaussians."""
    means = model.means.astype(np.float64)
    pieces = [np.arange(len(model))]
    while len(pieces[0]) > 1.5 * REGION:
        halves = []
        for piece in pieces:
            axis = int(np.argmax(np.ptp(means[piece], axis=0)))
            order = piece[np.argsort(means[piece, axis], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        pieces = halves
    label = np.empty(len(model), dtype=np.int64)
    for number, piece in enumerate(pieces):
        label[piece] = number
    neighbors = cKDTree(means).query(means, FAR + 1, workers=2)[1][:, 1:]
    return Regions(label, len(pieces), neighbors.astype(np.int64))


def measure_regions(model: GaussianModel, regions: Regions) -> Float64:
    """(regions.count, F) features of each region; the model is in the order that the regions were made of."""
    dc = model.sh[:, 0].astype(np.float64)
    colors = dc @ OPPONENT.T  # (N, 3)
    nearest = colors[regions.neighbors[:, 0]]
    near, far = (colors[regions.neighbors[:, :count]].mean(axis=1) for count in (NEAR, FAR))
    shapes = [_shape(values, regions) for values in (colors - nearest, colors - near, near - far, colors)]
    return np.concatenate([*shapes, _lattice(dc, regions)], axis=1)


def float_born(model: GaussianModel, rng: np.random.Generator) -> GaussianModel:
    """The model with DC colours spread over the cells of their lattice, as before a format rounded and clipped them.

    Scenes that can be had went through a format with few values; this is what their training had before it. Inner
    values lie anywhere in their cell. An outermost value also stands for all that was clipped there (training bounds
    no colour from above): where it holds more than its neighbour, it spreads in an exponential tail that begins with
    the neighbour's density.
    """
    dc = model.sh[:, 0].astype(np.float64)
    for c in range(3):
        values, place, count = np.unique(dc[:, c], return_inverse=True, return_counts=True)
        if len(values) < 2:
            continue
        middle = 0.5 * (values[1:] + values[:-1])
        low = np.concatenate([2 * values[:1] - middle[:1], middle])
        high = np.concatenate([middle, 2 * values[-1:] - middle[-1:]])
        spread = rng.uniform(low[place], high[place])
        for end, beside, wall, away in ((0, 1, high[0], -1.0), (-1, -2, low[-1], 1.0)):
            if count[end] > count[beside]:
                clipped = place == np.arange(len(values))[end]
                scale = count[end] / count[beside] * (high[beside] - low[beside])
                tail = rng.exponential(min(scale, LONGEST_TAIL), int(clipped.sum()))
                spread[clipped] = wall + away * tail
        dc[:, c] = spread
    return model.with_dc(dc.astype(np.float32))


def _shape(values: Float64, regions: Regions) -> Float64:
    """(count, 33) spread, tails, lean, channels' correlations and histogram of (N, 3) values."""
    spread = np.sqrt(_mean(values**2, regions)) + 1e-9  # (R, 3)
    scaled = values / spread[regions.label]
    bins = np.digitize(scaled, EDGES)  # (N, 3)
    inner = np.arange(1, len(EDGES))
    columns = [
        np.log(spread),
        np.log(_mean(np.abs(scaled), regions) + 1e-9),
        _mean(scaled**3, regions).clip(-20, 20),
        np.log(_mean(scaled**4, regions) + 1e-9),
        _mean(scaled * np.roll(scaled, 1, axis=1), regions),
        *(_mean((bins[:, c : c + 1] == inner).astype(np.float64), regions) for c in range(3)),
    ]
    return np.concatenate(columns, axis=1)


def _lattice(dc: Float64, regions: Regions) -> Float64:
    """(count, 6) how often a value is shared with other Gaussians, and how far off 8-bit levels it lies."""
    columns = []
    for values in dc.T:
        _, place, count = np.unique(values, return_inverse=True, return_counts=True)
        levels = 255.0 * (0.5 + SH_C0 * values)
        columns += [count[place] >= OFTEN, np.abs(levels - np.round(levels))]
    return _mean(np.stack(columns, axis=1), regions)


def _mean(values: Float64, regions: Regions) -> Float64:
    """(count, k) mean of (N, k) values over each region."""
    total = np.bincount(regions.label, minlength=regions.count).astype(np.float64)
    sums = [np.bincount(regions.label, column, regions.count) for column in values.T]
    return np.stack(sums, axis=1) / np.maximum(total, 1.0)[:, None]
