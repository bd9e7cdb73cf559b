"""A near-duplicate sketch: which registered models a suspect may derive from, without registering it to each.

It asks in two ways, and for mirror images, too; either is enough.

A sketch holds two thousand Gaussians of a model: of its visible half, those of the rarest looks in every region.
To compare, each is looked up among all Gaussians of the suspect by what no similarity changes (size ratios,
opacity, colour), and the partners found are counted by how many agree with each other: the same change of
size, the same turn, distances changed alike. In a derivative dozens do, in a foreign model two or three.

Merging and training anew leave none of the Gaussians; what lies about places all over the model stays (`coarse`).

A sketch is made of the model that is published: it says nothing that the public does not know. It proves nothing
either; it only saves registering a suspect to models it has nothing to do with.
"""

import struct
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from engine.errors import FormatError
from engine.model import Float32, Float64, GaussianModel, Int64
from engine.numerics.nearest import WhitenedGrid
from engine.numerics.similarity import MIRROR
from engine.registration.coarse import FEATURES, Coarse, Crowd, agreement, describe
from engine.registration.config import CONFIG
from engine.registration.match_candidates import by_region, invariant_features, log_sizes
from engine.registration.match_kernels import Pairs, degrees_of_agreement
from engine.registration.similarity_search import turns
from engine.registration.visibility import only_drawn

_CONFIG = CONFIG.sketch
_BUCKETS = 1 << 20
_MIX = np.array([73856093, 19349663, 83492791, 49979687, 67867979, 32452843], dtype=np.int32)
"""Features are compared by a hash; two looks in one bucket count as one."""

LOOK_ERRORS = np.array(CONFIG.sketch.look_errors, dtype=np.float32)

_MAGIC, _FIRST_MAGIC = b"M3DGSSK2", b"M3DGSSK1"
"""The first version had no places."""
_PREFIX = struct.Struct("<8sI")
_POINT = np.dtype([("mean", "<f4", 3), ("looks", "<f2", 6), ("size", "<f2"), ("quat", "i1", 4)])
_PLACE = np.dtype([("where", "<f4", 3), ("features", "<f2", FEATURES), ("size", "<f4")])


@dataclass(frozen=True, eq=False)
class Sketch:
    """P Gaussians of a model (at most `points`): centers, looks (P, 6) that no similarity changes (two log size ratios,
    opacity logit, DC), sizes (P,), the mean log of the two larger scales, and rotations; at most `places` places."""

    means: Float32
    looks: Float32
    sizes: Float32
    quats: Float32
    coarse: Coarse

    def __len__(self) -> int:
        return len(self.means)

    def to_bytes(self) -> bytes:
        """30 bytes a Gaussian, 56 a place: the same sketch gives the same bytes."""
        points = np.empty(len(self), dtype=_POINT)
        points["mean"], points["looks"], points["size"] = self.means, self.looks, self.sizes
        points["quat"] = np.round(127.0 * self.quats)
        places = np.empty(len(self.coarse), dtype=_PLACE)
        places["where"], places["features"] = self.coarse.places, self.coarse.features
        places["size"] = self.coarse.sizes
        return _PREFIX.pack(_MAGIC, len(self)) + points.tobytes() + places.tobytes()

    @classmethod
    def from_bytes(cls, data: bytes) -> "Sketch":
        """The sketch that `to_bytes` stored, now or in the first version; FormatError if it is none."""
        if len(data) < _PREFIX.size:
            raise FormatError("this is no sketch")
        magic, count = _PREFIX.unpack_from(data)
        end = _PREFIX.size + count * _POINT.itemsize
        places, odd = divmod(len(data) - end, _PLACE.itemsize)
        most = {_MAGIC: _CONFIG.places, _FIRST_MAGIC: 0}.get(magic, -1)
        if count > _CONFIG.points or not 0 <= places <= most or odd:
            raise FormatError("this is no sketch")
        points = np.frombuffer(data, dtype=_POINT, offset=_PREFIX.size, count=count)
        means, looks, sizes, quats = (np.asarray(points[name], dtype=np.float32) for name in _POINT.names or ())
        lengths = np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1.0)
        table = np.frombuffer(data, dtype=_PLACE, offset=end, count=places)
        coarse = Coarse(*(np.asarray(table[name], dtype=np.float32) for name in _PLACE.names or ()))
        return cls(means, looks, sizes, np.asarray(quats / lengths, dtype=np.float32), coarse)


def make_sketch(model: GaussianModel) -> Sketch:
    """The sketch of a model with at least one Gaussian; the same model gives the same sketch."""
    rows = _telling(model, _CONFIG.points)
    looks = invariant_features(model, rows, 0).astype(np.float32)
    sizes = log_sizes(model, rows).astype(np.float32)
    return Sketch(model.means[rows], looks, sizes, model.quats[rows], describe(model, _CONFIG.places))


class SuspectIndex:
    """A suspect laid out for comparing it with many sketches, without what no viewer draws."""

    def __init__(self, model: GaussianModel) -> None:
        self.model = model = only_drawn(model)
        looks = invariant_features(model, slice(None), 0).astype(np.float32) / LOOK_ERRORS
        self._rows = _uncrowded(looks)
        self._grid = WhitenedGrid(
            looks[self._rows], _no_turn(len(self._rows)), quat_weight=0.0, hard=len(LOOK_ERRORS), soft_cap=0.0
        )

    @cached_property
    def _crowd(self) -> Crowd:
        return Crowd(describe(self.model, _CONFIG.suspect_places, _CONFIG.ladder_steps))

    @cached_property
    def telling_looks(self) -> Float32:
        """(P, 6) looks of Gaussians among which are those that a sketch of this model, or of a part, would hold."""
        return invariant_features(self.model, _telling(self.model, _CONFIG.suspect_points), 0).astype(np.float32)

    @property
    def place_features(self) -> Float32:
        """(Q, FEATURES) what lies about places all over this model."""
        return self._crowd.suspect.features

    def resemblance(self, sketch: Sketch) -> int:
        """How many of a sketch's Gaussians, 0 to `most_pairs` - 1, have partners here that agree with one of them, or
        how much its places say, counted alike; the larger. See `SketchConfig.alike`."""
        votes = self._votes(sketch)
        if votes >= _CONFIG.alike:
            return votes
        return max(votes, int(min(agreement(sketch.coarse, self._crowd) / _CONFIG.nats, _CONFIG.most_pairs - 1)))

    def _votes(self, sketch: Sketch) -> int:
        near = self._grid.query(
            sketch.looks / LOOK_ERRORS, _no_turn(len(sketch)), box=_CONFIG.box, limit2=_CONFIG.limit2
        )
        found = np.flatnonzero(near.index >= 0)
        if len(found) < 2:
            return 0
        mine = found[np.argsort(-near.probability[found], kind="stable")[: _CONFIG.most_pairs]]
        theirs = self._rows[near.index[mine]]
        size = (sketch.sizes[mine] - log_sizes(self.model, theirs).astype(np.float32)).astype(np.float64)
        best = 0
        for mirrored in (False, True):
            means = self.model.means[theirs] * (MIRROR if mirrored else 1.0)
            turn = turns(sketch.quats[mine], self.model.quats[theirs], mirrored)
            pairs = Pairs(means.astype(np.float64), sketch.means[mine].astype(np.float64), size, turn)
            best = max(best, int(degrees_of_agreement(pairs, CONFIG.similarity.loose).max()))
        return best


def _telling(model: GaussianModel, count: int) -> Int64:
    """At most `count` rows, ascending, of the rarest looks in every region of the visible half: the faint one is what
    pruning takes first."""
    rows = np.flatnonzero(model.opacity_logits >= np.median(model.opacity_logits))
    rows = rows[:: max(1, len(rows) // _CONFIG.pool)]
    rarity = _rarity(invariant_features(model, rows, 0))
    return np.asarray(rows[np.sort(by_region(model.means[rows], rarity, count, _CONFIG.regions))])


def _uncrowded(points: Float32) -> Int64:
    """Indices, ascending, of at most `crowd` points of one look.

    Where thousands look the same, a partner carries no information, and searching for it takes most of the time.
    """
    steps = np.floor(np.float32(0.5) * points).astype(np.int32)
    bucket = (steps * _MIX).sum(axis=1, dtype=np.int32) & (_BUCKETS - 1)
    crowded = np.bincount(bucket, minlength=_BUCKETS) > _CONFIG.crowd
    if not crowded.any():
        return np.arange(len(points))
    kept = ~crowded[bucket]
    rows = np.flatnonzero(~kept)
    rows = rows[np.argsort(bucket[rows], kind="stable")]
    _, starts, counts = np.unique(bucket[rows], return_index=True, return_counts=True)
    kept[rows[np.arange(len(rows)) - np.repeat(starts, counts) < _CONFIG.crowd]] = True
    return np.flatnonzero(kept)


def _rarity(looks: Float64) -> Float64:
    """Squared Mahalanobis distance from the middle: the rarer a look, the fewer impostors elsewhere."""
    sample = looks[:: max(1, len(looks) // 20_000)]
    middle, spread = np.median(sample, axis=0), np.maximum(sample.std(axis=0), 1e-3)
    white = (looks - middle) / spread
    covariance = np.cov(((sample - middle) / spread).T) if len(sample) > 1 else np.eye(looks.shape[1])
    return np.asarray(np.einsum("ij,ij->i", white @ np.linalg.inv(covariance + 0.01 * np.eye(looks.shape[1])), white))


def _no_turn(count: int) -> Float32:
    return np.zeros((count, 4), dtype=np.float32)
