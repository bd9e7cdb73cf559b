"""A scene of many placed objects, found through a bounding-volume hierarchy of boxes and flattened into one model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.edits.bvh_kernels import NONE, along_ray, insert_all, overlapping
from engine.lab.sim.model_placement import join
from engine.model import Float64, GaussianModel, Int32, Int64
from engine.numerics.similarity import quaternion_to_rotation, transform_model
from engine.numerics.umeyama import Similarity


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


BOX_DEVIATIONS = 3.0
"""A bounding box reaches this many standard deviations past every center, as a splat on the screen does."""


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """A model in its own frame, its place in the scene (x_scene = scale * R @ x_model + t), its bounding box there."""

    name: str
    model: GaussianModel
    placement: Similarity
    low: Float64
    high: Float64

    @property
    def placed(self) -> GaussianModel:
        """The model in the scene's frame; SH turned with it."""
        p = self.placement
        return transform_model(self.model, p.scale, p.R, p.t)


@dataclass(frozen=True, eq=False)
class FlatScene:
    """All objects in one model, in the order of their insertion, and whose each Gaussian is: `owner` (N,) into `names`.

    SH is padded with zeros to the highest degree of the objects.
    """

    model: GaussianModel
    owner: Int32
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Scene:
    """Named objects and the hierarchy of their boxes; a value: every change gives a new scene."""

    # by a number that is never used again; ascending, so in the order of insertion
    objects: Mapping[int, PlacedObject] = field(default_factory=lambda: MappingProxyType({}))
    tree: BoxTree = field(default_factory=BoxTree.empty)  # of those numbers
    following: int = 0  # number of the next object

    def __len__(self) -> int:
        return len(self.objects)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the objects in the order of their insertion."""
        return tuple(o.name for o in self.objects.values())

    def insert(self, name: str, model: GaussianModel, placement: Similarity | None = None) -> Scene:
        """The scene with one more object; see `insert_all`."""
        return self.insert_all([(name, model, placement or Similarity.identity())])

    def insert_all(self, objects: Iterable[tuple[str, GaussianModel, Similarity]]) -> Scene:
        """The scene with more objects (name, model, placement).

        InputError if a name is empty or taken, a model is empty, or a placement no proper similarity.
        """
        taken = set(self.names)
        entries = dict(self.objects)
        new = []
        for name, model, placement in objects:
            if not name or name in taken:
                raise InputError(f"the scene already holds an object {name!r}" if name else "an object needs a name")
            if not len(model):
                raise InputError(f"object {name!r} is empty")
            taken.add(name)
            plain = model.with_(sh=model.sh[:, :1])  # its box depends on nothing else
            box = model_box(transform_model(plain, placement.scale, placement.R, placement.t))
            new.append(PlacedObject(name, model, placement, *box))
        numbers = np.arange(self.following, self.following + len(new))
        entries.update(zip(numbers.tolist(), new, strict=True))
        lows = np.array([o.low for o in new]).reshape(-1, 3)
        highs = np.array([o.high for o in new]).reshape(-1, 3)
        tree = self.tree.inserted(lows, highs, numbers)
        return Scene(MappingProxyType(entries), tree, self.following + len(new))

    def get(self, name: str) -> PlacedObject:
        """The object of that name; InputError if there is none."""
        return self.objects[self._number(name)]

    def in_box(self, low: npt.ArrayLike, high: npt.ArrayLike) -> tuple[str, ...]:
        """Names of the objects whose bounding box touches a box (3,), (3,), in the order of insertion."""
        return tuple(self.objects[int(k)].name for k in self.tree.overlapping(low, high))

    def along_ray(self, origin: npt.ArrayLike, direction: npt.ArrayLike) -> tuple[tuple[str, float], ...]:
        """(name, distance at which the ray enters its bounding box), nearest first; see `BoxTree.along_ray`."""
        items, distances = self.tree.along_ray(origin, direction)
        return tuple((self.objects[int(k)].name, float(d)) for k, d in zip(items, distances, strict=True))

    def flatten(self) -> FlatScene:
        """All objects in one model, in the order of insertion; InputError if the scene is empty."""
        if not self.objects:
            raise InputError("a scene without objects cannot be flattened")
        parts = [o.placed for o in self.objects.values()]
        owner = np.repeat(np.arange(len(parts), dtype=np.int32), [len(part) for part in parts])
        return FlatScene(join(*parts), owner, self.names)

    def _number(self, name: str) -> int:
        if name not in self.names:
            raise InputError(f"the scene holds no object {name!r}")
        return list(self.objects)[self.names.index(name)]


def model_box(model: GaussianModel) -> tuple[Float64, Float64]:
    """Corners (3,), (3,) of the axis-aligned box around every Gaussian, BOX_DEVIATIONS of it on each side."""
    axes = quaternion_to_rotation(model.quats) * model.scales.astype(np.float64)[:, None, :]  # (N, 3, 3): R S
    reach = BOX_DEVIATIONS * np.sqrt(np.square(axes).sum(axis=2))  # 3 sqrt(diag(R S S^T R^T))
    means = model.means.astype(np.float64)
    return (means - reach).min(axis=0), (means + reach).max(axis=0)
