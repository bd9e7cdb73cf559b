"""Vectors of many assets, and the assets whose vectors lie nearest to those of a suspect.

Each vector of the suspect votes for the assets among its nearest neighbors, by how much nearer they lie than the
first one that is left out: local naive Bayes nearest neighbours (McCann and Lowe 2012). A common
vector votes for none. The neighbors are FAISS's: all vectors are compared while they are few, then the nearest lists.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import faiss
import numpy as np
import numpy.typing as npt

from engine.catalogue.config import CONFIG
from engine.model import Float32, Float64, Int64

__all__ = ["Growing", "Neighbors", "Votes"]

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
