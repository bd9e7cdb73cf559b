"""What a model looks like from a little way off: how matter and colour lie about places all over it.

Merging neighbours, thinning, and even training anew change every Gaussian, but not where matter is and what colour it
has, averaged over a twentieth of the scene. So the model is reduced to voxels, and about places all over it a few
moments are taken that no similarity and no mirror changes. Two models are compared by the places that look alike: where
one similarity carries dozens of them onto each other, one model was made from the other.

The size of a neighbourhood follows from the model's own extent. A piece has a smaller one: a suspect is described at a
ladder of sizes.
"""

# mypy: allow-untyped-defs

import math
from dataclasses import dataclass

import numpy as np

from engine.kernels.jit import parallel_kernel, share_of
from engine.model import SH_C0, Float32, Float64, GaussianModel, Int64
from engine.numerics.similarity import MIRROR
from engine.registration.config import CONFIG
from engine.registration.hypotheses import chance_table
from engine.registration.match_kernels import Pairs, best_triples, evidence

_CONFIG = CONFIG.coarse
FEATURES = 20
"""Of each of two scales: mean colour (3), spreads along the principal axes (3), distance of the centroid from the
place, gradients of the three colours."""
MOST_CELLS = float(1 << 20)
"""Voxels along an axis on either side of the middle; what lies further out counts as there."""


@dataclass(frozen=True, eq=False)
class Coarse:
    """P places in a model: where (P, 3), in scene units; features (P, FEATURES); and the size of the neighbourhood that
    was described (P,), scene units."""

    places: Float32
    features: Float32
    sizes: Float32

    def __len__(self) -> int:
        return len(self.places)


@parallel_kernel
def _moments(mass, where, color, places, window, reach, out, count, call):
    """About each place, at half the window and at the whole: mass, its first (3) and second (6) moments, colour (3) and
    colour times offset (9), to `out`; and to `count` how many voxels are within reach. Both hold zeros."""
    for p in share_of(len(places), call):
        for v in range(len(mass)):
            x, y, z = where[v, 0] - places[p, 0], where[v, 1] - places[p, 1], where[v, 2] - places[p, 2]
            d2 = x * x + y * y + z * z
            if d2 > reach * reach:
                continue
            count[p] += 1
            for s in range(2):
                width = window * (0.5 + 0.5 * s)
                g = mass[v] * math.exp(-0.5 * d2 / (width * width))
                row = out[p, s]
                row[0] += g
                row[1] += g * x
                row[2] += g * y
                row[3] += g * z
                row[4] += g * x * x
                row[5] += g * y * y
                row[6] += g * z * z
                row[7] += g * x * y
                row[8] += g * y * z
                row[9] += g * z * x
                for c in range(3):
                    row[10 + c] += g * color[v, c]
                    row[13 + 3 * c] += g * color[v, c] * x
                    row[14 + 3 * c] += g * color[v, c] * y
                    row[15 + 3 * c] += g * color[v, c] * z


def describe(model: GaussianModel, most: int, steps: int = 1) -> Coarse:
    """At most `most` places all over a model for each of `steps` sizes of neighbourhood, the smallest first; none where
    the model has no extent."""
    if len(model) > _CONFIG.most_gaussians:
        model = model.take(np.arange(0, len(model), -(-len(model) // _CONFIG.most_gaussians)))
    mass = _mass(model)
    extent = _extent(model.means, mass)
    matter = mass, model.means.astype(np.float64), np.clip(0.5 + SH_C0 * model.sh[:, 0].astype(np.float64), 0.0, 1.0)
    found = []
    for step in range(steps if extent > 0 else 0):
        window = _CONFIG.neighborhood * extent * _CONFIG.ladder**step
        weight, where, color = _voxels(matter, _CONFIG.voxel * window)
        heavy, at, _ = _voxels(matter, _CONFIG.apart * window)
        if step == 0:
            matter = weight, where, color  # coarser voxels are filled by the finest
        places = at[heavy > 0.2 * np.median(heavy)]  # not about floaters
        if len(places) > most:
            places = places[np.sort(np.random.default_rng(0).choice(len(places), most, replace=False))]
        moments, count = np.zeros((len(places), 2, 22)), np.zeros(len(places), np.int64)
        _moments(weight, where, color, places, window, _CONFIG.reach * window, moments, count)
        usable = (count >= _CONFIG.least_voxels) & (moments[:, 0, 0] > 0)
        features = np.concatenate([_features(moments[usable, s], window * (0.5 + 0.5 * s)) for s in range(2)], axis=1)
        found.append((places[usable], features, np.full(usable.sum(), window)))
    if not found:
        return Coarse(np.zeros((0, 3), np.float32), np.zeros((0, FEATURES), np.float32), np.zeros(0, np.float32))
    return Coarse(*(np.concatenate(parts).astype(np.float32) for parts in zip(*found, strict=True)))


class Crowd:
    """A suspect's places, laid out for comparing them with those of many sketches."""

    def __init__(self, suspect: Coarse) -> None:
        self.suspect = suspect
        if len(suspect):
            self._scale = np.maximum(suspect.features.std(axis=0), _CONFIG.least_spread)
            self._features = np.ascontiguousarray((suspect.features / self._scale).T)  # (FEATURES, Q)
            self._squares = np.square(self._features).sum(axis=0)

    def partners(self, sketch: Coarse) -> Int64:
        """(P,) the place that looks most like each of a sketch's."""
        products = (-2.0 * sketch.features / self._scale) @ self._features
        products += self._squares
        return np.asarray(np.argmin(products, axis=1))


def agreement(sketch: Coarse, suspect: Crowd) -> float:
    """Evidence, in nats, that one similarity, or a mirror and one, carries places of a suspect onto those of a sketch;
    0 where there is none."""
    if len(sketch) < 4 or len(suspect.suspect) < 4:
        return 0.0
    partner = suspect.partners(sketch)
    y = sketch.places.astype(np.float64)
    extent = float(np.median(sketch.sizes)) / _CONFIG.neighborhood
    chance = chance_table(y, extent, np.random.default_rng(0), samples=20_000)
    size = np.log(sketch.sizes.astype(np.float64) / suspect.suspect.sizes[partner])
    turn = np.zeros((len(y), 4))
    seeds = np.arange(0, len(y), max(1, len(y) // _CONFIG.seeds), dtype=np.int64)
    best = 0.0
    for mirror in (np.ones(3), MIRROR):
        x = suspect.suspect.places[partner].astype(np.float64) * mirror
        pairs = Pairs(x, y, size, turn)
        triples = best_triples(pairs, _CONFIG.agreement, extent, chance, seeds=seeds, draws=_CONFIG.draws, seed=0)
        at = int(np.argmax(triples.scores))
        if triples.scores[at] <= best:
            continue
        R, moved = triples.turns[at], triples.moves[at]
        shuffles = [np.random.default_rng(i).permutation(len(y)) for i in range(_CONFIG.shuffles)]
        size_error = _CONFIG.agreement.size
        accident = max(evidence(pairs.shuffled(s), R, moved, size_error, extent, chance)[0] for s in shuffles)
        best = max(best, float(triples.scores[at]) - accident)
    return best


def _mass(model: GaussianModel) -> Float64:
    """(N,) opacity times area: what merging two neighbours about keeps."""
    scales = np.sort(model.log_scales.astype(np.float64), axis=1)
    return np.asarray(model.opacities * np.exp(np.clip(scales[:, 1] + scales[:, 2], -60.0, 60.0)))


def _extent(means: Float32, mass: Float64) -> float:
    """Median distance from the median centre, by mass, scene units."""
    center = np.array([_median(means[:, axis].astype(np.float64), mass) for axis in range(3)])
    return _median(np.linalg.norm(means - center, axis=1), mass)


def _median(values: Float64, weights: Float64) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, 0.5 * total[-1])]])


def _voxels(matter: tuple[Float64, Float64, Float64], side: float) -> tuple[Float64, Float64, Float64]:
    """Mass (V,), centroid (V, 3) and mean colour (V, 3) of each voxel that holds any of matter: masses (N,), places
    (N, 3) and colours (N, 3)."""
    mass, places, colors = matter
    cells = np.floor(np.clip(places / side, -MOST_CELLS, MOST_CELLS)).astype(np.int64)
    cells -= cells.min(axis=0)
    _, home = np.unique((cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2], return_inverse=True)
    total: Float64 = np.bincount(home, mass).astype(np.float64)
    rows = np.concatenate([places, colors], axis=1)
    mean = (
        np.stack([np.bincount(home, mass * rows[:, k]) for k in range(6)], axis=1) / np.maximum(total, 1e-300)[:, None]
    )
    return total, np.ascontiguousarray(mean[:, :3]), np.ascontiguousarray(mean[:, 3:])


def _features(moments: Float64, width: float) -> Float64:
    """(P, FEATURES / 2) what neither similarity nor mirror changes, of moments (P, 22)."""
    mean = moments[:, 1:] / moments[:, :1]
    offset, color = mean[:, :3], mean[:, 9:12]
    xx, yy, zz, xy, yz, zx = mean[:, 3:9].T
    second = np.stack([xx, xy, zx, xy, yy, yz, zx, yz, zz], axis=1).reshape(-1, 3, 3)
    spread = np.linalg.eigvalsh(second - offset[:, :, None] * offset[:, None]) / width**2
    slopes = mean[:, 12:].reshape(-1, 3, 3) - color[:, :, None] * offset[:, None]  # (P, colour, axis)
    return np.concatenate(
        [
            color,
            np.sqrt(np.maximum(spread, 0.0)),
            np.linalg.norm(offset, axis=1, keepdims=True) / width,
            np.linalg.norm(slopes, axis=2) / width,
        ],
        axis=1,
    )
