"""A dynamic bounding-volume hierarchy of axis-aligned boxes: insert, remove, and box, point and ray queries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.edits.bvh_kernels import ITEM, LEFT, NONE, along_ray, insert_all, overlapping, remove
from engine.model import Float64, Int64

__all__ = ["BoxTree"]


@dataclass(frozen=True, eq=False)
class BoxTree:
    """Boxes in a binary tree, a value: inserting and removing give a new tree (a copy of 80 bytes a box)."""

    boxes: Float64  # (nodes, 6) low and high corner of every node
    links: Int64  # (nodes, 4) parent, children, item
    root: int  # -1 in an empty tree

    @classmethod
    def empty(cls) -> BoxTree:
        """The tree of no boxes."""
        return cls(np.empty((0, 6)), np.empty((0, 4), np.int64), NONE)

    def __len__(self) -> int:
        return (len(self.links) + 1) // 2

    def inserted(self, lows: npt.ArrayLike, highs: npt.ArrayLike, items: npt.ArrayLike) -> BoxTree:
        """The tree with more boxes, corners low <= high (m, 3); InputError if one is malformed.

        Queries answer with the items (m,): not negative, each in the tree at most once (the caller's business).
        """
        low, high = (np.asarray(v, dtype=np.float64).reshape(-1, 3) for v in (lows, highs))
        names = np.asarray(items, dtype=np.int64).reshape(-1)
        if not len(low) == len(high) == len(names):
            raise InputError(f"{len(low)} low corners, {len(high)} high corners, {len(names)} items")
        bad = np.flatnonzero(~(np.isfinite(low) & np.isfinite(high) & (low <= high)).all(axis=1))
        if len(bad):
            raise InputError(f"no box: low {low[bad[0]].tolist()}, high {high[bad[0]].tolist()}")
        start = len(self.links)
        nodes = max(0, 2 * (len(self) + len(names)) - 1)
        boxes, links = np.empty((nodes, 6)), np.empty((nodes, 4), np.int64)
        boxes[:start], links[:start] = self.boxes, self.links
        root = insert_all(boxes, links, self.root, len(names), low, high, names, start)
        return BoxTree(boxes, links, int(root))

    def removed(self, item: int) -> BoxTree:
        """The tree without an item; InputError if it holds none of that number."""
        leaf = np.flatnonzero((self.links[:, ITEM] == item) & (self.links[:, LEFT] == NONE))
        if not len(leaf):
            raise InputError(f"the tree holds no item {item}")
        boxes, links = self.boxes.copy(), self.links.copy()
        root = int(remove(boxes, links, self.root, int(leaf[0])))
        left = max(0, len(links) - 2)
        return BoxTree(boxes[:left].copy(), links[:left].copy(), root)

    def overlapping(self, low: npt.ArrayLike, high: npt.ArrayLike) -> Int64:
        """Items whose box touches the box low..high (3,), ascending; a point is a box with low = high."""
        if self.root == NONE:
            return np.empty(0, np.int64)
        bottom, top = (np.asarray(v, dtype=np.float64) for v in (low, high))
        if bottom.shape != (3,) or top.shape != (3,) or not (bottom <= top).all():
            raise InputError(f"no box: low {low!r}, high {high!r}")
        return np.sort(overlapping(self.boxes, self.links, self.root, bottom, top))

    def along_ray(self, origin: npt.ArrayLike, direction: npt.ArrayLike) -> tuple[Int64, Float64]:
        """Items (m,) whose box a ray meets, nearest first, and the distances (m,) at which it enters them, scene units.

        The direction need not be of unit length; not zero. Boxes that hold the origin are at distance 0.
        """
        start, way = (np.asarray(v, dtype=np.float64) for v in (origin, direction))
        length = float(np.linalg.norm(way))
        if start.shape != (3,) or way.shape != (3,) or not (np.isfinite(start).all() and 0 < length < np.inf):
            raise InputError(f"no ray: origin {origin!r}, direction {direction!r}")
        if self.root == NONE:
            return np.empty(0, np.int64), np.empty(0)
        items, entry = along_ray(self.boxes, self.links, self.root, start, way / length)
        order = np.lexsort((items, entry))
        return items[order], entry[order]
