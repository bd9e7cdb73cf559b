"""Nearest neighbours in a space of about ten coordinates, each measured in its own expected error.

A kd-tree is slow in ten dimensions. Here a true partner is known to lie within a few units in *every*
coordinate, so a grid over the five best-spread coordinates leaves few candidates, and these are contiguous in
memory.
"""

# mypy: allow-untyped-defs

import math
from dataclasses import dataclass

import numpy as np

from engine.kernels.jit import inlined, kernel, parallel_kernel, share_of
from engine.model import Float32, Int32, Int64

AXES = 5
"""Coordinates under the grid."""
MAX_CELLS = 16
"""Grid cells along one coordinate: 16^5 cell offsets are 4 MB and stay in the cache."""
REACH = np.float32(9.0)
"""Candidates this much (squared) farther than the best count for less than exp(-4.5) of it: left out."""


@dataclass(frozen=True, eq=False)
class Neighbors:
    """The answer of a query of M points: `index` (M,) int32 of the nearest reference point, -1 if none lies within the
    limits; `distance2` (M,) float32, its squared distance, infinity if there is none; `probability` (M,) float32.

    The last is exp(-d^2/2) of the nearest over the sum of the candidates': the chance that the nearest is the right one
    if the errors are standard normal and one of the candidates is right. 0 if there is none.
    """

    index: Int32
    distance2: Float32
    probability: Float32

    @property
    def pairs(self) -> tuple[Int32, Int64]:
        """Reference point and queried point of each match."""
        hit = np.flatnonzero(self.index >= 0)
        return self.index[hit], hit


class WhitenedGrid:
    """Reference points under a grid, for nearest-neighbour queries within a box.

    Parameters
    ----------
    points : (N, D) float32
        Coordinates divided by the expected error of a true match, D >= 5.
    quats : (N, 4) float32
        Unit quaternions; the angle between two counts as three more coordinates.
    quat_weight : float
        1 / sigma^2 of a rotation error about one axis, 1/rad^2; 0 leaves rotations out.
    hard : int
        The first `hard` coordinates count in full; the squared distance in the others is capped.
    soft_cap : float
        Cap, in squared units.
    """

    def __init__(self, points: Float32, quats: Float32, *, quat_weight: float, hard: int, soft_cap: float) -> None:
        spread = np.subtract(*np.percentile(points[:: max(1, len(points) // 20000)], [90, 10], axis=0))
        self.axes = np.ascontiguousarray(np.argsort(-spread[:hard], kind="stable")[:AXES].astype(np.int64))
        cells = int(np.clip(round(1.2 * len(points) ** (1 / AXES)), 1, MAX_CELLS))
        self.edges = np.stack([_edges(points[:, a], cells) for a in self.axes])  # (AXES, cells - 1)
        cell = self._cells_of(points)
        self.start, self.order = _counting_sort(cell, cells**AXES)
        self.points, self.quats = np.empty_like(points), np.empty_like(quats)
        _gather(points, self.order, self.points)
        _gather(quats, self.order, self.quats)
        self.quat_weight = np.float32(quat_weight)
        self.hard, self.soft_cap = hard, np.float32(soft_cap)

    def _cells_of(self, points: Float32) -> Int32:
        out = np.empty(len(points), np.int32)
        _cells(points, self.axes, self.edges, out)
        return out

    def query(self, points: Float32, quats: Float32, *, box: float, limit2: float) -> Neighbors:
        """Nearest reference point of each of M points (M, D), with quaternions (M, 4) in the reference's frame already.

        `box` is the largest deviation in each of the grid's five coordinates, `limit2` the largest squared distance.
        """
        cell = self._cells_of(points)
        # neighbours in space are neighbours in the cache
        if len(cell) < len(self.start) // 16:
            order = np.argsort(cell, kind="stable").astype(np.int32)
        else:
            _, order = _counting_sort(cell, len(self.start) - 1)
        m = len(points)
        index = np.full(m, -1, np.int32)
        distance2 = np.full(m, np.inf, np.float32)
        probability = np.zeros(m, np.float32)
        grid = (self.points, self.quats, self.start, self.order, self.axes, self.edges)
        rules = (self.hard, self.soft_cap, self.quat_weight)
        found = (index, distance2, probability)
        _search(grid, *rules, points, quats, order, np.float32(box), np.float32(limit2), found)
        return Neighbors(index, distance2, probability)


def _edges(values: Float32, cells: int) -> Float32:
    """Inner cell edges at the quantiles of a sample, so that every cell holds about as many points."""
    sample = np.sort(values[:: max(1, len(values) // 20000)])
    at = (np.arange(1, cells) * len(sample)) // cells
    return sample[at].astype(np.float32)


@inlined
def _cell_along(edges, g, value):
    """Number of coordinate g's edges <= value."""
    low, high = 0, edges.shape[1]
    while low < high:
        middle = (low + high) >> 1
        if edges[g, middle] <= value:
            low = middle + 1
        else:
            high = middle
    return low


@parallel_kernel
def _cells(points, axes, edges, out, call):
    per_axis = edges.shape[1] + 1
    for i in share_of(len(points), call):
        cell = 0
        for g in range(AXES):
            cell = cell * per_axis + _cell_along(edges, g, points[i, axes[g]])
        out[i] = cell


def _counting_sort(cell: Int32, count: int) -> tuple[Int32, Int32]:
    """Offsets (count + 1,) and the stable order of the points by cell."""
    start, order = np.zeros(count + 1, np.int32), np.empty(len(cell), np.int32)
    _sort_by_cell(cell, start, np.empty(count, np.int32), order)
    return start, order


@kernel
def _sort_by_cell(cell, start, fill, order):
    """`_counting_sort`, to `start`, which holds zeros, and `order`; `fill` (count,) is scratch."""
    for c in cell:
        start[c + 1] += 1
    for c in range(len(fill)):
        start[c + 1] += start[c]
        fill[c] = start[c]
    for i in range(len(cell)):
        c = cell[i]
        order[fill[c]] = i
        fill[c] += 1


@parallel_kernel
def _gather(rows, order, out, call):
    for i in share_of(len(order), call):
        for k in range(rows.shape[1]):
            out[i, k] = rows[order[i], k]


@inlined
def _gap2(edges, g, cell, value):
    """Squared distance of a value from a cell along coordinate g."""
    gap = np.float32(0.0)
    if cell > 0:
        gap = max(gap, edges[g, cell - 1] - value)
    if cell < edges.shape[1]:
        gap = max(gap, value - edges[g, cell])
    return gap * gap


@inlined
def _scan(refs, ref_quats, first, last, hard, soft_cap, quat_weight, points, quats, i, limit2, state):
    """Candidates first..last of one query; state is (least squared distance, sum of likelihoods, who)."""
    best, total, found = state
    dims = refs.shape[1]
    for p in range(first, last):
        bound = min(limit2, best + REACH)
        d = np.float32(0.0)
        # Rotations first: the grid knows nothing of them, so they turn most candidates away.
        if quat_weight > 0:
            dot = np.float32(0.0)
            for k in range(4):
                dot += ref_quats[p, k] * quats[i, k]
            # |dot| = cos(angle / 2), so angle^2 is about 8 (1 - |dot|)
            d = np.float32(8.0) * max(np.float32(0.0), np.float32(1.0) - abs(dot)) * quat_weight
            if d > bound:
                continue
        for k in range(hard):
            e = refs[p, k] - points[i, k]
            d += e * e
        if d > bound:
            continue
        soft = np.float32(0.0)
        for k in range(hard, dims):
            e = refs[p, k] - points[i, k]
            soft += e * e
        d += min(soft, soft_cap)
        if d > bound:
            continue
        if found < 0:
            best, total, found = d, np.float32(1.0), np.int64(p)
        elif d < best:
            total = np.float32(total * math.exp(np.float32(0.5) * (d - best)) + 1.0)
            best, found = d, np.int64(p)
        else:
            total = np.float32(total + math.exp(np.float32(0.5) * (best - d)))
    return best, total, found


@parallel_kernel
def _search(grid, hard, soft_cap, quat_weight, points, quats, order, box, limit2, found, call):
    refs, ref_quats, start, ref_order, axes, edges = grid
    index, distance2, probability = found
    per_axis = edges.shape[1] + 1
    for rank in share_of(len(order), call):
        i = order[rank]
        z0, z1, z2 = points[i, axes[0]], points[i, axes[1]], points[i, axes[2]]
        z3, z4 = points[i, axes[3]], points[i, axes[4]]
        home = 0
        for g in range(AXES - 1):
            home = home * per_axis + _cell_along(edges, g, points[i, axes[g]])
        home *= per_axis
        low, high = _cell_along(edges, 4, z4 - box), _cell_along(edges, 4, z4 + box)
        state = (limit2, np.float32(0.0), np.int64(-1))
        # The home cells first: a good partner there spares most of the others.
        first, last = start[home + low], start[home + high + 1]
        state = _scan(refs, ref_quats, first, last, hard, soft_cap, quat_weight, points, quats, i, limit2, state)
        for c0 in range(_cell_along(edges, 0, z0 - box), _cell_along(edges, 0, z0 + box) + 1):
            g0 = _gap2(edges, 0, c0, z0)
            for c1 in range(_cell_along(edges, 1, z1 - box), _cell_along(edges, 1, z1 + box) + 1):
                g1 = g0 + _gap2(edges, 1, c1, z1)
                if g1 > state[0] + REACH:
                    continue
                for c2 in range(_cell_along(edges, 2, z2 - box), _cell_along(edges, 2, z2 + box) + 1):
                    g2 = g1 + _gap2(edges, 2, c2, z2)
                    if g2 > state[0] + REACH:
                        continue
                    for c3 in range(_cell_along(edges, 3, z3 - box), _cell_along(edges, 3, z3 + box) + 1):
                        if g2 + _gap2(edges, 3, c3, z3) > min(limit2, state[0] + REACH):
                            continue
                        base = (((c0 * per_axis + c1) * per_axis + c2) * per_axis + c3) * per_axis
                        if base == home:
                            continue
                        first, last = start[base + low], start[base + high + 1]
                        state = _scan(
                            refs, ref_quats, first, last, hard, soft_cap, quat_weight, points, quats, i, limit2, state
                        )
        if state[2] >= 0:
            index[i] = ref_order[state[2]]
            distance2[i] = state[0]
            probability[i] = np.float32(1.0) / state[1]
