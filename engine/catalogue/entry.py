"""What the index keeps of an asset: a sketch of its model, and how its surface looks from all sides."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from engine.catalogue.config import CONFIG
from engine.errors import FormatError
from engine.model import Camera, Float32, Int64
from engine.pictures.camera.camera_motion import project
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.registration.sketch import Sketch

__all__ = ["Entry", "SeenPoints", "see_points"]

MOST_POINTS = 1 << 16
"""More are no entry of ours."""


_MAGIC = b"M3DGSEN1"
_PREFIX = struct.Struct("<8sII")
_POINT = np.dtype([("descriptor", "u1", 128), ("view", "<u2"), ("place", "<u2", 2)])
_STEPS = 16.0
"""Places are kept in sixteenths of a pixel."""


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """P landmarks where views showed them: `descriptors` (P, 128), `views` (P,) and `places` (P, 2) x, y in the view's
    pixels."""

    descriptors: npt.NDArray[np.uint8]
    views: npt.NDArray[np.int32]
    places: Float32

    def __len__(self) -> int:
        return len(self.views)


@dataclass(frozen=True, eq=False)
class Entry:
    """One asset."""

    sketch: Sketch
    seen: SeenPoints | None  # None where the asset has no landmarks

    def to_bytes(self) -> bytes:
        """The same entry gives the same bytes."""
        sketch, seen = self.sketch.to_bytes(), self.seen
        points = np.empty(0 if seen is None else len(seen), dtype=_POINT)
        if seen is not None:
            points["descriptor"], points["view"] = seen.descriptors, seen.views
            points["place"] = np.clip(np.round(_STEPS * seen.places), 0, 65535)
        return _PREFIX.pack(_MAGIC, len(sketch), len(points)) + sketch + points.tobytes()

    @classmethod
    def from_bytes(cls, data: bytes) -> Entry:
        """The entry that `to_bytes` stored, or a sketch alone, as it was stored before; FormatError if it is none."""
        if len(data) < _PREFIX.size or data[: len(_MAGIC)] != _MAGIC:
            return cls(Sketch.from_bytes(data), None)
        _, length, count = _PREFIX.unpack_from(data)
        end = _PREFIX.size + length
        if count > MOST_POINTS or len(data) != end + count * _POINT.itemsize:
            raise FormatError("this is no entry of an index")
        sketch = Sketch.from_bytes(data[_PREFIX.size : end])
        if not count:
            return cls(sketch, None)
        points = np.frombuffer(data, dtype=_POINT, offset=end, count=count)
        places = points["place"].astype(np.float32) / np.float32(_STEPS)
        return cls(sketch, SeenPoints(points["descriptor"].copy(), points["view"].astype(np.int32), places))


def see_points(landmarks: Landmarks, cameras: Sequence[Camera]) -> SeenPoints:
    """The landmarks of every view that most other views show, too, where it showed them; the strongest of those that
    as many do. `cameras` are those the landmarks were made from."""
    most = CONFIG.points // max(len(cameras), 1)
    shown = _views_of_each(landmarks, cameras)
    rows = [np.flatnonzero(landmarks.views == view) for view in range(len(cameras))]
    rows = [np.sort(mine[np.argsort(-shown[mine], kind="stable")[:most]]) for mine in rows]
    places = [
        project(landmarks.points[mine].astype(np.float64), camera) for mine, camera in zip(rows, cameras, strict=True)
    ]
    chosen = np.concatenate(rows) if rows else np.zeros(0, np.int64)
    where = np.concatenate(places).astype(np.float32) if places else np.zeros((0, 2), np.float32)
    return SeenPoints(landmarks.descriptors[chosen], landmarks.views[chosen], where)


def _views_of_each(landmarks: Landmarks, cameras: Sequence[Camera]) -> Int64:
    """(L,) how many views show each landmark, its own among them: at the same place of the world, and looking alike."""
    if not len(landmarks):
        return np.zeros(0, np.int64)
    eyes = np.array([camera.position for camera in cameras])
    distance = np.median(np.linalg.norm(landmarks.points - eyes[landmarks.views], axis=1))
    reach = CONFIG.same_place * distance / cameras[0].K[0, 0]
    tree = scipy.spatial.cKDTree(landmarks.points)
    _, near = tree.query(landmarks.points, CONFIG.neighbors, distance_upper_bound=reach)
    descriptors = landmarks.descriptors.astype(np.float32)
    shown_by = np.zeros((len(landmarks), len(cameras)), dtype=bool)
    for column in near.T:
        row = np.flatnonzero(column < len(landmarks))
        other = column[row]
        alike = np.linalg.norm(descriptors[row] - descriptors[other], axis=1) < CONFIG.same_look
        shown_by[row[alike], landmarks.views[other[alike]]] = True
    return np.asarray(shown_by.sum(axis=1))
