"""Where on the asset the mark is: evidence by region, at a proven false-discovery rate (DESIGN 4.9).

**Control.** Every chip that is counted lies in one region of those that follow from the plan alone (`divide`). In a
region without the mark the products of message and chips are fair signs given y, weights and all chips of the other
regions. So p = tries * exp(-z^2 / 2) is a p-value there (Hoeffding, `statistics`), and the p-values of such regions are
independent of each other and of the rest.
Then the step-up procedure of Benjamini and Hochberg (1995, theorem 1) at level q keeps the expected share of such
regions among those called marked at q or less; where no region has the mark, q is the chance of any discovery at all.
`tries` are all hypotheses of the verification, so neither layer nor record may have been chosen for it.

**What it is about**: which regions of the reference do not carry this mark in the suspect. Nothing is assumed about the
suspect, its author or its noise. Like a claim it holds for signs that had no part in making what lies in the region. q
is a rate against chance: who tries 10^10 plans is stopped by the claim's own bound, not by this.

**How it would be lost.** Regions that were drawn by looking at chip * y, such as "where it agrees"; one chip in two
regions; a layer or record chosen by z and not counted. `join` may look at y and weights as a registration may, never at
a sign. tests/theory plays the first.

`altered` is a measurement and no theorem, see `RegionConfig.altered_rate`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt
import scipy

from engine.errors import InputError
from engine.model import Bool, Float32, Float64, Int32
from engine.watermark.config import CONFIG
from engine.watermark.grain import ATTRIBUTES
from engine.watermark.layout import Layout
from engine.watermark.messages import Signs
from engine.watermark.model_evidence import Evidence
from engine.watermark.statistics import magnitude, z_threshold

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


_CONFIG = CONFIG.regions
LAYERS = (slice(0, 1), slice(1, 2), slice(0, 2))
"""Tint, grain, both: the questions of `layers`, as parts of a list of the two."""


class State(IntEnum):
    """What is known of a region; greater says more."""

    UNSEEN = 0  # the suspect does not show it
    UNCLEAR = 1  # it is seen, and neither of the following can be said
    ALTERED = 2  # it is there, its mark would have shown, and does not
    MARKED = 3  # it carries the mark


@dataclass(frozen=True)
class RegionConfig:
    """What regions are tested for."""

    # q: largest expected share of regions without the mark among those called marked; in (0, 1)
    false_discoveries: float = 0.01
    most: int = 256  # regions at most, a power of two
    # Largest chance, in (0, 1), that a region is called altered in which all layers keep the `surviving` share of their
    # strength, by the noise measured there: the inequality of `power`, which takes it to know nothing of the mark
    altered_rate: float = 1e-6
    surviving: float = 0.5

    def __post_init__(self) -> None:
        for name in ("false_discoveries", "altered_rate"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InputError(f"{name} must lie in (0, 1), got {getattr(self, name)}")
        if not 0.0 < self.surviving <= 1.0:
            raise InputError(f"surviving must lie in (0, 1], got {self.surviving}")
        if self.most < 1 or self.most & (self.most - 1):
            raise InputError(f"most must be a power of two, got {self.most}")


@dataclass(frozen=True, eq=False)
class Regions:
    """K regions of the reference, and what one suspect says of each."""

    partition: Partition
    state: Int32  # (K,) `State`
    z: Float64  # (K,) of the strongest layer, or of both together; 0 where nothing was tested
    log10_p: Float64  # (K,) all tries counted; 0 where nothing was tested
    expected: Float64  # (K,) z of the mark at full strength, of the layer that expects most
    tested: int  # regions that were tested: those that had enough chips
    false_discoveries: float  # q

    def of_gaussians(self) -> Int32:
        """(N,) `State` of the region that each Gaussian of the reference lies in."""
        return np.asarray(self.state[self.partition.of_gaussians], dtype=np.int32)


def judge_regions(
    evidence: Sequence[Evidence],
    signs: Signs,
    leaves: Partition,
    tint: int,
    *,
    tries: int,
    found: Bool | None = None,
    config: RegionConfig = RegionConfig(),
) -> Regions:
    """The state of every region.

    Parameters
    ----------
    evidence : sequence of Evidence
        Of C chips, one or several ways to read one suspect, all counted in `tries`; the first says what is seen.
    signs : (C,) +-1
        Chip times bit of the registered message.
    leaves : Partition
        The smallest regions (`divide`); they are joined where the evidence is thin.
    tint : int
        How many of the chips are the first layer's.
    tries : int
        Hypotheses of the whole verification, at least those tested here.
    found : (N,) bool, optional
        Which Gaussians of the reference the suspect holds; None (pictures): no region is called altered.
    """
    terms = [_Terms.of(each) for each in evidence]
    small = [each.moments(leaves, tint) for each in terms]
    number = join(leaves, small[0], _enough, _seen)
    partition = leaves.renumbered(number)
    moments = [np.zeros((partition.count, *each.shape[1:])) for each in small]
    for whole, halves in zip(moments, small, strict=True):
        np.add.at(whole, number, halves)
    tested = _chips(moments[0]) >= _CONFIG.least_chips  # from sizes alone; only now come the signs
    z = np.stack(
        [
            _ratio(_questions(partition.sums(each.wy * signs, tint)), np.sqrt(_questions(sums[..., _WY2])))
            for each, sums in zip(terms, moments, strict=True)
        ]
    )
    z = np.where(tested, z.reshape(-1, partition.count).max(axis=0), 0.0)
    log10_p = np.minimum(0.0, math.log10(tries) - np.square(np.maximum(z, 0.0)) / (2.0 * math.log(10.0)))
    state = np.where(_seen(moments[0]), State.UNCLEAR, State.UNSEEN).astype(np.int32)
    if found is not None:
        held = np.bincount(partition.of_gaussians, found, partition.count)
        there = held >= _CONFIG.present * np.maximum(np.bincount(partition.of_gaussians, minlength=partition.count), 1)
        quiet = z < z_threshold(config.false_discoveries, tries)
        state[tested & there & quiet & _would_have_shown(moments[0], tries, config)] = State.ALTERED
    state[np.flatnonzero(tested)[discoveries(log10_p[tested], config.false_discoveries)]] = State.MARKED
    expected = np.where(tested, _expected(moments[0]).max(axis=0), 0.0)
    return Regions(partition, state, z, log10_p, expected, int(tested.sum()), config.false_discoveries)


def discoveries(log10_p: Float64, level: float) -> Bool:
    """(m,) which of m hypotheses the step-up procedure of Benjamini and Hochberg (1995) rejects at a level.

    The largest k whose k-th smallest p is at most level * k / m, and all up to it.
    """
    m = len(log10_p)
    ordered = np.sort(log10_p)
    passed = np.flatnonzero(ordered <= np.log10(level * np.arange(1, m + 1) / max(m, 1)))
    return np.asarray(log10_p <= ordered[passed[-1]] if len(passed) else np.zeros(m, dtype=bool))


_WS, _WY2, _WS2, _E2, _WY2_WS, _WY2_WS2 = range(6)


@dataclass(frozen=True, eq=False)
class _Terms:
    """(C,) w y and w s, scaled so that the largest of both is 1."""

    wy: Float64
    ws: Float64

    @classmethod
    def of(cls, evidence: Evidence) -> "_Terms":
        wy, ws = evidence.evidence, evidence.weights * evidence.signal
        unit = max(magnitude(wy), magnitude(ws)) or 1.0
        return cls(wy / unit, ws / unit)

    def moments(self, partition: Partition, tint: int) -> Float64:
        """(count, 2, 6) sums over chips by region and layer, without a sign; where regions join, they add up."""
        wy2, ws2 = self.wy**2, self.ws**2
        terms = (self.ws, wy2, ws2, (wy2 + ws2) ** 2, wy2 * self.ws, wy2 * ws2)
        return np.stack([partition.sums(term, tint) for term in terms], axis=2)


def _questions(values: Float64) -> Float64:
    """(3, K) of (K, 2): each layer's, and both together."""
    return np.stack([values[:, 0], values[:, 1], values.sum(axis=1)])


def _ratio(above: Float64, below: Float64) -> Float64:
    return np.divide(above, below, out=np.zeros_like(above), where=below > 0)


def _expected(moments: Float64) -> Float64:
    """(3, K) z of each question that the mark at full strength would give, as `power.expected_z`."""
    return _ratio(_questions(moments[..., _WS]), np.sqrt(_questions(moments[..., _WY2] + moments[..., _WS2])))


def _chips(moments: Float64) -> Float64:
    """(K,) number of chips, counted by their shares of the evidence: equal ones count one each."""
    energy = (moments[..., _WY2] + moments[..., _WS2]).sum(axis=1)
    return _ratio(energy**2, moments[..., _E2].sum(axis=1))


def _seen(moments: Float64) -> Bool:
    return np.asarray(moments[..., _WS2].sum(axis=1) > 0)


def _enough(moments: Float64) -> Bool:
    return np.asarray((_expected(moments).max(axis=0) >= _CONFIG.enough) & (_chips(moments) >= _CONFIG.least_chips))


def _would_have_shown(moments: Float64, tries: int, config: RegionConfig) -> Bool:
    """(K,) whether each layer that says anything there would have reached the bar, with the wanted `power`."""
    bar, share = z_threshold(config.false_discoveries, tries), config.surviving
    m = moments
    root = np.sqrt(m[..., _WY2] + share**2 * m[..., _WS2])  # (K, 2)
    slope = _ratio(np.full_like(root, bar * share), root)
    spread = np.maximum(m[..., _WY2] - 2.0 * slope * m[..., _WY2_WS] + slope**2 * m[..., _WY2_WS2], 0.0)
    margin = share * m[..., _WS] - bar * root
    enough = np.square(np.maximum(margin, 0.0)) >= -2.0 * math.log(config.altered_rate) * spread
    return np.asarray(((margin > 0) & enough | (m[..., _WS2] == 0)).all(axis=1))
