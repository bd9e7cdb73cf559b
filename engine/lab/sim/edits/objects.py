"""A scene of many placed objects, found through a bounding-volume hierarchy of boxes and flattened into one model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.model_placement import join
from engine.model import Float64, GaussianModel, Int32, Int64
from engine.numerics.similarity import quaternion_to_rotation, transform_model
from engine.numerics.umeyama import Similarity


@dataclass(frozen=True, eq=False)
class Volume:
    """A node of a hierarchy of bounding volumes: the box around two halves of some items, or around one item."""

    low: Float64  # (3,)
    high: Float64
    halves: tuple[Volume, ...] = ()
    item: int = -1  # of a leaf

    @classmethod
    def around(cls, lows: Float64, highs: Float64, items: Int64) -> Volume:
        """The hierarchy of boxes (m, 3), (m, 3), halved at the median of their middles along the longest side."""
        low, high = lows.min(axis=0), highs.max(axis=0)
        if len(items) == 1:
            return cls(low, high, item=int(items[0]))
        order = np.argsort((lows + highs)[:, np.argmax(high - low)], kind="stable")
        parts = (order[: len(order) // 2], order[len(order) // 2 :])
        return cls(low, high, tuple(cls.around(lows[part], highs[part], items[part]) for part in parts))

    def overlapping(self, low: npt.ArrayLike, high: npt.ArrayLike) -> list[int]:
        """Items whose box touches the box low..high (3,), ascending; a point is a box with low = high."""
        bottom, top = (np.asarray(v, dtype=np.float64) for v in (low, high))
        if bottom.shape != (3,) or top.shape != (3,) or not (bottom <= top).all():
            raise InputError(f"no box: low {low!r}, high {high!r}")
        found, waiting = [], [self]
        while waiting:
            node = waiting.pop()
            if (node.low <= top).all() and (node.high >= bottom).all():
                waiting += node.halves
                found += [] if node.halves else [node.item]
        return sorted(found)

    def along_ray(self, origin: npt.ArrayLike, direction: npt.ArrayLike) -> list[tuple[float, int]]:
        """Distances (scene units) at which a ray enters boxes, and their items, nearest first.

        The direction need not be of unit length; not zero. Boxes that hold the origin are at distance 0.
        """
        start, way = (np.asarray(v, dtype=np.float64) for v in (origin, direction))
        length = float(np.linalg.norm(way))
        if start.shape != (3,) or way.shape != (3,) or not (np.isfinite(start).all() and 0 < length < np.inf):
            raise InputError(f"no ray: origin {origin!r}, direction {direction!r}")
        found, waiting = [], [self]
        while waiting:
            node = waiting.pop()
            entry = node._entry(start, way / length)
            if entry is not None:
                waiting += node.halves
                found += [] if node.halves else [(entry, node.item)]
        return sorted(found)

    def _entry(self, origin: Float64, way: Float64) -> float | None:
        """The distance at which a ray enters the box, None where it misses it."""
        level = way == 0.0  # never leaves its slab: in or out for good
        if ((origin < self.low) | (origin > self.high))[level].any():
            return None
        crossed = np.stack([(wall - origin)[~level] / way[~level] for wall in (self.low, self.high)])
        near, far = max(0.0, float(crossed.min(axis=0).max())), float(crossed.max(axis=0).min())
        return near if near <= far else None


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
    """Named objects, in the order of their insertion, under the hierarchy of their boxes.

    A value: every change gives a new scene.
    """

    objects: Mapping[str, PlacedObject] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.objects)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the objects."""
        return tuple(self.objects)

    @cached_property
    def _volume(self) -> Volume | None:
        lows, highs = (np.array([getattr(o, end) for o in self.objects.values()]) for end in ("low", "high"))
        return Volume.around(lows, highs, np.arange(len(self))) if len(self) else None

    def insert(self, name: str, model: GaussianModel, placement: Similarity | None = None) -> Scene:
        """The scene with one more object; see `insert_all`."""
        return self.insert_all([(name, model, placement or Similarity.identity())])

    def insert_all(self, objects: Iterable[tuple[str, GaussianModel, Similarity]]) -> Scene:
        """The scene with more objects (name, model, placement).

        InputError if a name is empty or taken, a model is empty, or a placement no proper similarity.
        """
        entries = dict(self.objects)
        for name, model, placement in objects:
            if not name or name in entries:
                raise InputError(f"the scene already holds an object {name!r}" if name else "an object needs a name")
            if not len(model):
                raise InputError(f"object {name!r} is empty")
            plain = model.with_(sh=model.sh[:, :1])  # its box depends on nothing else
            box = model_box(transform_model(plain, placement.scale, placement.R, placement.t))
            entries[name] = PlacedObject(name, model, placement, *box)
        return Scene(entries)

    def get(self, name: str) -> PlacedObject:
        """The object of that name; InputError if there is none."""
        if name not in self.objects:
            raise InputError(f"the scene holds no object {name!r}")
        return self.objects[name]

    def in_box(self, low: npt.ArrayLike, high: npt.ArrayLike) -> tuple[str, ...]:
        """Names of the objects whose bounding box touches a box (3,), (3,), in the order of insertion."""
        return tuple(self.names[k] for k in self._volume.overlapping(low, high)) if self._volume else ()

    def along_ray(self, origin: npt.ArrayLike, direction: npt.ArrayLike) -> tuple[tuple[str, float], ...]:
        """(name, distance at which the ray enters its bounding box), nearest first; see `Volume.along_ray`."""
        met = self._volume.along_ray(origin, direction) if self._volume else []
        return tuple((self.names[k], distance) for distance, k in met)

    def flatten(self) -> FlatScene:
        """All objects in one model, in the order of insertion; InputError if the scene is empty."""
        if not self.objects:
            raise InputError("a scene without objects cannot be flattened")
        parts = [o.placed for o in self.objects.values()]
        owner = np.repeat(np.arange(len(parts), dtype=np.int32), [len(part) for part in parts])
        return FlatScene(join(*parts), owner, self.names)


def model_box(model: GaussianModel) -> tuple[Float64, Float64]:
    """Corners (3,), (3,) of the axis-aligned box around every Gaussian, BOX_DEVIATIONS of it on each side."""
    axes = quaternion_to_rotation(model.quats) * model.scales.astype(np.float64)[:, None, :]  # (N, 3, 3): R S
    reach = BOX_DEVIATIONS * np.sqrt(np.square(axes).sum(axis=2))  # 3 sqrt(diag(R S S^T R^T))
    means = model.means.astype(np.float64)
    return (means - reach).min(axis=0), (means + reach).max(axis=0)
