"""Disjoint regions of the reference, from the plan alone: neighbouring code vectors of stage 0 and their Gaussians."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from engine.model import Bool, Float32, Float64, Int32
from engine.watermark.config import CONFIG
from engine.watermark.grain import ATTRIBUTES
from engine.watermark.layout import Layout

Ask = Callable[[Float64], Bool]


@dataclass(frozen=True, eq=False)
class Partition:
    """Regions 0 to count - 1. Made by `divide`, their numbers are leaves: 2 k and 2 k + 1 are halves of one."""

    count: int
    chips: int  # of stage 0, those of one code vector in a row
    of_codes: Int32  # (codes,) of each code vector of stage 0, -1 where it carries nothing
    of_gaussians: Int32  # (N,)

    def sums(self, per_chip: Float64, tint: int) -> Float64:
        """(count, 2) sums of (C,) values over the tint's and the grain's chips of each region; `tint` is how many chips
        the first has.

        Every chip counts in one region or, those of further stages, whose code vectors are all over the asset, in none.
        """
        codes, total = len(self.of_codes), np.zeros((self.count, 2))
        carries = np.flatnonzero(self.of_codes >= 0)
        carriers = self.chips // codes
        first = per_chip[: self.chips].reshape(codes, carriers).sum(axis=1)
        total[:, 0] = np.bincount(self.of_codes[carries], first[carries], self.count)
        if len(per_chip) > tint:
            grain = per_chip[tint:].reshape(-1, ATTRIBUTES).sum(axis=1)
            total[:, 1] = np.bincount(self.of_gaussians, grain, self.count)
        return total

    def renumbered(self, number: Int32) -> "Partition":
        """Regions (count,) under new numbers, those of one number joined."""
        codes = np.where(self.of_codes >= 0, number[self.of_codes], -1).astype(np.int32)
        return Partition(int(number.max(initial=-1)) + 1, self.chips, codes, number[self.of_gaussians])


def divide(layout: Layout, means: Float32, most: int) -> Partition:
    """A balanced k-d tree over the middles of the code vectors' Gaussians, at centres `means` (N, 3).

    `most` leaves, a power of two, or as many as have `codes` code vectors each.
    """
    labels, codes = layout.labels[0], layout.codes[0]
    chips = codes * len(layout.directions[0])
    members = np.bincount(labels, minlength=codes)
    carries = (layout.split(layout.amplitudes)[0] > 0).any(axis=1) & (members > 0)
    sums = np.stack([np.bincount(labels, column, codes) for column in means.T.astype(np.float64)], axis=1)
    middles = sums[carries] / members[carries, None]
    if not len(middles):
        return Partition(1, chips, np.full(codes, -1, np.int32), np.zeros(len(means), np.int32))
    leaves = [np.arange(len(middles))]
    for _ in range(int(math.log2(max(1, min(most, len(middles) // CONFIG.regions.codes))))):
        leaves = [half for leaf in leaves for half in _halves(leaf, middles)]
    leaf = np.empty(len(middles), np.int32)
    for number, rows in enumerate(leaves):
        leaf[rows] = number
    of_codes = np.full(codes, -1, np.int32)
    of_codes[carries] = leaf
    of_gaussians = of_codes[labels]
    still = np.flatnonzero(of_gaussians < 0)  # code vectors that carry nothing; their Gaussians' grain does
    if len(still):
        of_gaussians[still] = leaf[scipy.spatial.cKDTree(middles).query(means[still].astype(np.float64), workers=2)[1]]
    return Partition(len(leaves), chips, of_codes, of_gaussians)


def _halves(rows: npt.NDArray[np.int64], middles: Float64) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Rows of a leaf, cut at the median of its longest side."""
    axis = int(np.argmax(np.ptp(middles[rows], axis=0)))
    order = rows[np.argsort(middles[rows, axis], kind="stable")]
    return order[: len(order) // 2], order[len(order) // 2 :]


def join(partition: Partition, sums: Float64, enough: Ask, seen: Ask) -> Int32:
    """(count,) new number of each leaf, joined with its other half, from the bottom, where one is seen and not enough.

    Parameters
    ----------
    sums : (count, ...)
        What adds up over chips: none of it may know a sign.
    enough, seen : callables
        Of sums (k, ...), which suffice for a region of their own, and which are of one that the suspect shows at all.
    """
    number = np.arange(partition.count, dtype=np.int32)
    alone: Bool = np.ones(partition.count, dtype=np.bool_)  # nodes of this level that are one region
    for level in range(1, partition.count.bit_length()):
        shown = seen(sums)
        weak = (shown & ~enough(sums)).reshape(-1, 2).any(axis=1)
        blank = ~shown.reshape(-1, 2).any(axis=1)
        alone = np.asarray(alone.reshape(-1, 2).all(axis=1) & (weak | blank))
        sums = sums.reshape(len(alone), 2, *sums.shape[1:]).sum(axis=1)
        for node in np.flatnonzero(alone):
            number[node << level : (node + 1) << level] = node << level
    return np.unique(number, return_inverse=True)[1].astype(np.int32)
