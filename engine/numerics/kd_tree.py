"""The nearest of many points in a space of up to about ten coordinates, without a bound on how far they may be.

SciPy has such a tree, but importing `scipy.spatial` takes 0.24 CPU seconds; a verification of a model loads no other
part of SciPy, and takes 0.6 to 1.0.
"""

# mypy: allow-untyped-defs

import math

import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.model import Float64, Int64

_LEAF = 16
"""Points of a leaf, at most."""
_SAMPLE = 64
"""Points of a node, about, that its widest coordinate is measured on."""


class KdTree:
    """Points (N, D), N > 0, halved along their widest coordinate until few are left in a node.

    Nodes are counted as in a heap: those below node i are 2 i + 1 and 2 i + 2, and all leaves are at one depth.
    """

    def __init__(self, points: Float64) -> None:
        count, dims = points.shape
        self._depth = max(0, math.ceil(math.log2(count / _LEAF)))
        self._ends = np.empty(((2 << self._depth) - 1, 2), dtype=np.int64)
        self._ends[0] = 0, count
        self._order, keys = np.arange(count), np.empty(count)
        points = np.ascontiguousarray(points)
        for level in range(self._depth):
            _halve(points, self._order, keys, self._ends, (1 << level) - 1)
        self._points = points[self._order]
        self._boxes = np.empty((len(self._ends), 2, dims))
        for level in range(self._depth, -1, -1):
            _enclose(self._points, self._ends, self._boxes, (1 << level) - 1)

    def __len__(self) -> int:
        return len(self._points)

    def nearest(self, queries: Float64, count: int) -> tuple[Float64, Int64]:
        """Distances (Q, K) and indices (Q, K) of the `count` points nearest to each of queries (Q, D), the nearest
        first; of equally near ones the first. Where there are fewer points, the others are infinitely far and have the
        index N."""
        distance2 = np.full((len(queries), count), np.inf)
        index = np.full((len(queries), count), len(self), dtype=np.int64)
        stack = np.empty((len(queries), self._depth + 2), dtype=np.int64)
        tree = (self._points, self._order, self._ends, self._boxes)
        _search(tree, np.ascontiguousarray(queries), stack, distance2, index)
        return np.sqrt(distance2), index


@parallel_kernel
def _halve(points, order, keys, ends, first, call):
    """The points of a level's nodes, the first of which is `first`, in two halves for those below; `keys` (N,) is
    scratch."""
    for turn in share_of(first + 1, call):
        node = first + turn
        begin, end = ends[node]
        widest, width = 0, -1.0
        for d in range(points.shape[1]):
            low = high = points[order[begin], d]
            for i in range(begin, end, max(1, (end - begin) // _SAMPLE)):
                low, high = min(low, points[order[i], d]), max(high, points[order[i], d])
            if high - low > width:
                widest, width = d, high - low
        for i in range(begin, end):
            keys[i] = points[order[i], widest]
        middle = (begin + end) // 2
        _select(keys, order, begin, end, middle)
        ends[2 * node + 1, 0], ends[2 * node + 1, 1] = begin, middle
        ends[2 * node + 2, 0], ends[2 * node + 2, 1] = middle, end


@inlined
def _select(keys, order, begin, end, middle):
    """Order begin..end so that no key before `middle` exceeds one from there on (Hoare's selection)."""
    low, high = begin, end - 1
    while low < high:
        pivot = keys[(low + high) >> 1]
        i, j = low, high
        while i <= j:
            while keys[i] < pivot:
                i += 1
            while keys[j] > pivot:
                j -= 1
            if i <= j:
                keys[i], keys[j] = keys[j], keys[i]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break


@parallel_kernel
def _enclose(points, ends, boxes, first, call):
    """The boxes of a level's nodes, those below having theirs; a leaf's are its points'."""
    inner = len(ends) // 2
    for turn in share_of(first + 1, call):
        node = first + turn
        for d in range(points.shape[1]):
            if node < inner:
                low = min(boxes[2 * node + 1, 0, d], boxes[2 * node + 2, 0, d])
                high = max(boxes[2 * node + 1, 1, d], boxes[2 * node + 2, 1, d])
            else:
                low = high = points[ends[node, 0], d]
                for p in range(ends[node, 0] + 1, ends[node, 1]):
                    low, high = min(low, points[p, d]), max(high, points[p, d])
            boxes[node, 0, d], boxes[node, 1, d] = low, high


@inlined
def _gap2(boxes, node, queries, q):
    """Squared distance of a query from a node's box."""
    total = 0.0
    for d in range(queries.shape[1]):
        gap = max(0.0, max(boxes[node, 0, d] - queries[q, d], queries[q, d] - boxes[node, 1, d]))
        total += gap * gap
    return total


@parallel_kernel
def _search(tree, queries, stack, distance2, index, call):
    points, order, ends, boxes = tree
    inner = len(ends) // 2
    for q in share_of(len(queries), call):
        stack[q, 0], waiting = 0, 1
        while waiting > 0:
            waiting -= 1
            node = stack[q, waiting]
            if _gap2(boxes, node, queries, q) > distance2[q, -1]:
                continue
            if node < inner:
                near, far = 2 * node + 1, 2 * node + 2
                if _gap2(boxes, far, queries, q) < _gap2(boxes, near, queries, q):
                    near, far = far, near
                stack[q, waiting], stack[q, waiting + 1] = far, near
                waiting += 2
                continue
            for p in range(ends[node, 0], ends[node, 1]):
                total = 0.0
                for d in range(queries.shape[1]):
                    off = points[p, d] - queries[q, d]
                    total += off * off
                _insert(distance2[q], index[q], total, order[p])


@inlined
def _insert(distance2, index, value, point):
    """Put a point in its place among the nearest, of which the last falls out."""
    k = len(index)
    while k > 0 and (value < distance2[k - 1] or (value == distance2[k - 1] and point < index[k - 1])):
        k -= 1
        if k + 1 < len(index):
            distance2[k + 1], index[k + 1] = distance2[k], index[k]
        distance2[k], index[k] = value, point
