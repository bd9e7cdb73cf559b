"""The index over all assets (DESIGN 4.8): which of them does a suspect come from, the likeliest first?

A model votes by its rarest Gaussians, which survive cutting and converting, and by places all over it, which survive
merging and training anew; the assets that come first are compared with it properly (`sketch.resemblance`). A picture
votes by keypoints, as it is and turned over, and what counts is how many votes for one view of an asset agree.

Each vector of the suspect votes for the assets among its nearest neighbors, by how much nearer they lie than the
first one that is left out: local naive Bayes nearest neighbors (McCann and Lowe 2012). A common vector votes for
none. The neighbors are FAISS's: all vectors are compared while they are few, then the nearest lists.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import faiss
import numpy as np
import numpy.typing as npt

from engine.catalogue.config import CONFIG
from engine.catalogue.entry import Entry
from engine.model import Float32, Float64, Int64
from engine.pictures.camera.voted_views import agreement_of_views
from engine.pictures.landmarks.keypoints import detect_keypoints, luma
from engine.registration.config import CONFIG as REGISTRATION
from engine.registration.sketch import LOOK_ERRORS, Sketch, SuspectIndex

__all__ = ["Catalogue", "Growing", "Likeness", "Neighbors", "Votes", "screen_model", "screen_pictures"]

PER_LIST = 39
"""Least vectors to learn the middle of a list from, FAISS's own demand."""


@dataclass(frozen=True, eq=False)
class Votes:
    """V votes: by which query, for which vector, and how loud (0 to 1)."""

    query: Int64
    row: Int64
    gain: Float64


class Growing:
    """An array to which much is appended before it is looked at."""

    def __init__(self, first: npt.NDArray[Any]) -> None:
        self._parts = [first]

    def append(self, part: npt.NDArray[Any]) -> None:
        """Rows behind those that are there."""
        self._parts.append(part)

    @property
    def whole(self) -> npt.NDArray[Any]:
        """All rows."""
        if len(self._parts) > 1:
            self._parts = [np.concatenate(self._parts)]
        return self._parts[0]


class Neighbors:
    """Vectors (N, d) and the assets they belong to."""

    def __init__(self, index: Any, owner: npt.NDArray[np.int32]) -> None:
        self._index = index
        self._owner = Growing(owner)

    @property
    def owner(self) -> npt.NDArray[Any]:
        """(N,) number of the asset."""
        return self._owner.whole

    @classmethod
    def learnt(cls, sample: Float32, expected: int, codec: str) -> Neighbors:
        """An empty one for about `expected` vectors like those of the sample (S, d); `codec` is how FAISS keeps each
        where they are many."""
        dimensions = sample.shape[1]
        lists = 1 << max(0, min(CONFIG.most_lists, len(sample) // PER_LIST).bit_length() - 1)
        if expected <= CONFIG.few or lists < CONFIG.probes:
            return cls(faiss.IndexFlatL2(dimensions), np.zeros(0, np.int32))
        index: Any = faiss.index_factory(dimensions, f"IVF{lists},{codec}")
        index.cp.niter = CONFIG.lessons
        index.train(np.ascontiguousarray(sample, dtype=np.float32))
        index.nprobe = CONFIG.probes
        return cls(index, np.zeros(0, np.int32))

    def __len__(self) -> int:
        return int(self._index.ntotal)

    def add(self, asset: int, vectors: Float32) -> None:
        """Vectors (n, d) of an asset."""
        if len(vectors):
            self._index.add(np.ascontiguousarray(vectors, dtype=np.float32))
            self._owner.append(np.full(len(vectors), asset, np.int32))

    def votes(self, queries: Float32) -> Votes:
        """What vectors (Q, d) of a suspect say."""
        none = np.zeros(0, dtype=np.int64)
        if not len(self) or not len(queries):
            return Votes(none, none, np.zeros(0))
        most = CONFIG.nearest
        squares, rows = self._index.search(np.ascontiguousarray(queries, dtype=np.float32), most + 1)
        distance = np.sqrt(np.maximum(squares, 0.0, dtype=np.float64))
        counted = (rows >= 0).sum(axis=1)
        yardstick = distance[np.arange(len(rows)), np.maximum(counted - 1, 0)]
        gain = 1.0 - distance[:, :most] / np.maximum(yardstick, 1e-12)[:, None]
        gain = np.where(counted[:, None] == most + 1, gain, (distance[:, :most] == 0).astype(np.float64))
        query, column = np.nonzero((rows[:, :most] >= 0) & (gain > 0))
        return Votes(query, rows[query, column].astype(np.int64), gain[query, column])

    def by_asset(self, votes: Votes, assets: int) -> Float64:
        """(assets,) sum of votes, of each query only the loudest for an asset."""
        owner = self.owner[votes.row].astype(np.int64)
        order = np.lexsort((-votes.gain, owner, votes.query))
        pair = votes.query[order] * assets + owner[order]
        first = order[np.unique(pair, return_index=True)[1]]
        return np.bincount(owner[first], votes.gain[first], assets).astype(np.float64)

    def save(self, path: Path) -> None:
        """Two files, `path` with suffixes."""
        faiss.write_index(self._index, str(path.with_suffix(".faiss")))
        np.save(path.with_suffix(".owner.npy"), self.owner)

    @classmethod
    def load(cls, path: Path, *, growing: bool) -> Neighbors:
        """What `save` wrote; the vectors stay on disk until they are looked at, unless more are to come."""
        index: Any = faiss.read_index(str(path.with_suffix(".faiss")), 0 if growing else faiss.IO_FLAG_MMAP_IFC)
        if hasattr(index, "nprobe"):
            index.nprobe = CONFIG.probes
        return cls(index, np.load(path.with_suffix(".owner.npy")))


PLACE_SPREAD = np.array(CONFIG.place_spread * 2, dtype=np.float32)
"""(20,) `place_spread` at both scales."""
FIELDS = {"looks": (len(LOOK_ERRORS), "Flat"), "places": (len(PLACE_SPREAD), "Flat"), "seen": (128, "SQ4")}
"""Length of vectors, and how FAISS keeps them where they are many: in 24, 80 and 64 bytes."""
VIEWS = 1 << 14
"""More than an asset has: views of all assets are numbered through."""


class Sketches:
    """Sketches as bytes, one behind the other: those of a file stay on disk until first use."""

    def __init__(self, data: npt.NDArray[np.uint8] | None = None, ends: Iterable[int] = ()) -> None:
        self._data = np.zeros(0, np.uint8) if data is None else data
        self._ends = list(ends)
        self._added: list[bytes] = []

    def add(self, sketch: Sketch) -> None:
        """One more."""
        self._added.append(sketch.to_bytes())

    def __getitem__(self, number: int) -> Sketch:
        if number >= len(self._ends):
            return Sketch.from_bytes(self._added[number - len(self._ends)])
        begin = self._ends[number - 1] if number else 0
        return Sketch.from_bytes(self._data[begin : self._ends[number]].tobytes())

    def save(self, path: Path) -> list[int]:
        """Where each ends in the file, bytes."""
        with path.open("wb") as file:
            self._data.tofile(file)
            file.writelines(self._added)
        ends = list(self._ends)
        for each in self._added:
            ends.append((ends[-1] if ends else 0) + len(each))
        return ends


class Catalogue:
    """Assets by name, in the order they came."""

    def __init__(
        self, names: Iterable[str], fields: dict[str, Neighbors], views: Int64, places: Float32, sketches: Sketches
    ) -> None:
        self.names = list(names)
        self._number = {name: number for number, name in enumerate(self.names)}
        self._fields, self._sketches = fields, sketches
        self._views, self._places = Growing(views), Growing(places)  # (N,) and (N, 2) of the field "seen"

    @classmethod
    def build(cls, names: Sequence[str], load: Callable[[str], Entry]) -> Catalogue:
        """The index of many assets; each entry is loaded once, those of `teachers` twice."""
        chosen = np.random.default_rng(0).permutation(len(names))[: CONFIG.teachers]
        vectors = [_vectors(load(names[i])) for i in np.sort(chosen)]
        fields = {}
        for field, (length, codec) in FIELDS.items():
            sample = np.concatenate([np.zeros((0, length), np.float32), *(each[field] for each in vectors)])
            expected = len(sample) * len(names) // max(1, len(vectors))
            fields[field] = Neighbors.learnt(sample, expected, codec)
        made = cls([], fields, np.zeros(0, np.int64), np.zeros((0, 2), np.float32), Sketches())
        for name in names:
            made.add(name, load(name))
        return made

    def __len__(self) -> int:
        return len(self.names)

    def add(self, name: str, entry: Entry) -> None:
        """One more asset."""
        number = len(self.names)
        self.names.append(name)
        self._number[name] = number
        self._sketches.add(entry.sketch)
        for field, vectors in _vectors(entry).items():
            self._fields[field].add(number, vectors)
        if entry.seen is not None:
            self._views.append(VIEWS * number + entry.seen.views.astype(np.int64))
            self._places.append(entry.seen.places)

    @property
    def unseen(self) -> list[str]:
        """Assets that no picture can speak for: without landmarks."""
        seen = np.bincount(self._fields["seen"].owner, minlength=len(self))
        return [name for name, points in zip(self.names, seen, strict=True) if not points]

    def sketch(self, name: str) -> Sketch:
        """Of an asset that is here."""
        return self._sketches[self._number[name]]

    def like_model(self, suspect: SuspectIndex) -> list[str]:
        """Assets that a model may come from, the likeliest of either way of asking in turn."""
        by_looks = self._sums("looks", suspect.telling_looks / LOOK_ERRORS)
        by_places = self._sums("places", suspect.place_features / PLACE_SPREAD)
        orders = [np.argsort(-votes, kind="stable")[: (votes > 0).sum()] for votes in (by_places, by_looks)]
        most = max(len(order) for order in orders)
        padded = [np.append(order, np.full(most - len(order), -1)) for order in orders]
        turns = (int(number) for pair in zip(*padded, strict=True) for number in pair if number >= 0)
        return [self.names[number] for number in dict.fromkeys(turns)]

    def like_pictures(self, pictures: Sequence[Float32]) -> list[tuple[str, float]]:
        """The assets that pictures (h, w, 3), 0..1, of one asset may show, the likeliest first, and how loud
        the votes are that agree."""
        total = np.zeros(len(self))
        for picture in pictures:
            keypoints = detect_keypoints(luma(picture), CONFIG.keypoints)
            hands = keypoints, keypoints.turned_over(picture.shape[1])
            total += np.maximum(*(self._agreement(hand.points, hand.descriptors) for hand in hands))
        order = np.argsort(-total, kind="stable")[: (total > 0).sum()]
        return [(self.names[number], float(total[number])) for number in order]

    def _sums(self, field: str, queries: Float32) -> Float64:
        near = self._fields[field]
        return near.by_asset(near.votes(queries), len(self))

    def _agreement(self, points: Float64, descriptors: npt.NDArray[np.uint8]) -> Float64:
        """(assets,) of the view of each that agrees best."""
        votes = self._fields["seen"].votes(descriptors.astype(np.float32))
        best = np.zeros(len(self))
        if not len(votes.row):
            return best
        view = self._views.whole[votes.row]
        names, of = np.unique(view, return_inverse=True)
        loud = np.zeros(len(names), dtype=bool)
        loud[np.argsort(-np.bincount(of, votes.gain), kind="stable")[: CONFIG.loudest]] = True
        mine = loud[of]
        seen, agree, _ = agreement_of_views(
            view[mine],
            points[votes.query[mine]],
            self._places.whole[votes.row[mine]].astype(np.float64),
            votes.gain[mine],
        )
        np.maximum.at(best, seen // VIEWS, agree)
        return best

    def save(self, folder: Path) -> None:
        """Into an empty folder."""
        for field, near in self._fields.items():
            near.save(folder / field)
        np.savez(folder / "views.npz", views=self._views.whole, places=self._places.whole)
        ends = self._sketches.save(folder / "sketches.bin")
        (folder / "assets.json").write_text(json.dumps({"names": self.names, "ends": ends}))

    @classmethod
    def load(cls, folder: Path, *, growing: bool = False) -> Catalogue:
        """What `save` wrote; most of it stays on disk until it is looked at, unless assets are to be added."""
        fields = {field: Neighbors.load(folder / field, growing=growing) for field in FIELDS}
        plain = json.loads((folder / "assets.json").read_text())
        sketches = Sketches(np.memmap(folder / "sketches.bin", np.uint8, "r"), plain["ends"]) if plain["ends"] else None
        with np.load(folder / "views.npz") as kept:
            return cls(plain["names"], fields, kept["views"], kept["places"], sketches or Sketches())


def _vectors(entry: Entry) -> dict[str, Float32]:
    """What each field of the index knows of an asset."""
    sketch = entry.sketch
    rows = np.linspace(0, len(sketch) - 1, min(CONFIG.looks, len(sketch))).astype(np.int64)
    seen = np.zeros((0, 128), np.float32) if entry.seen is None else entry.seen.descriptors.astype(np.float32)
    return {"looks": sketch.looks[rows] / LOOK_ERRORS, "places": sketch.coarse.features / PLACE_SPREAD, "seen": seen}


@dataclass(frozen=True)
class Likeness:
    """An asset that a suspect may come from, and what speaks for it."""

    name: str
    votes: float  # of a model as `SuspectIndex.resemblance`, of pictures as `Catalogue.like_pictures`
    alike: bool  # whether that is more than strangers have


def screen_model(catalogue: Catalogue, suspect: SuspectIndex, among: Container[str] | None = None) -> list[Likeness]:
    """The likeliest assets that a model comes from, of those in question (all where None), the likeliest first."""
    names = [name for name in catalogue.like_model(suspect) if among is None or name in among]
    found: list[Likeness] = []
    for begin in range(0, min(len(names), CONFIG.most_compared), CONFIG.compared):
        votes = [(name, suspect.resemblance(catalogue.sketch(name))) for name in names[begin : begin + CONFIG.compared]]
        found += [Likeness(name, float(count), count >= REGISTRATION.sketch.alike) for name, count in votes]
        if max(count for _, count in votes) < REGISTRATION.sketch.alike:
            break
    return sorted(found, key=lambda each: -each.votes)


def screen_pictures(
    catalogue: Catalogue, pictures: Sequence[Float32], among: Container[str] | None = None
) -> list[Likeness]:
    """The assets that pictures of one asset may show, the likeliest first; those that no vote speaks for are
    left out."""
    ranked = catalogue.like_pictures(pictures)
    return [Likeness(name, votes, votes >= CONFIG.shown) for name, votes in ranked if among is None or name in among]
