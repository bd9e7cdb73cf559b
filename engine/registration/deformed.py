"""Registration of a suspect that no single similarity explains: bent, twisted, squashed, or posed.

It runs only where the similarity leaves whole regions unexplained, or errs by a smooth amount. Patches are found
where nothing is explained yet, and grown (`patches`, `growth`).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from engine.model import Bool, Float32, Float64, GaussianModel, Int32, Int64
from engine.numerics.kd_tree import KdTree
from engine.numerics.time_budget import UNLIMITED, TimeBudget
from engine.numerics.umeyama import Similarity
from engine.registration.config import CONFIG
from engine.registration.growth import grow
from engine.registration.looks_index import ReferenceIndex
from engine.registration.match_candidates import sample_rows
from engine.registration.matching import Deviations
from engine.registration.patches import Patch, find_patches

_CONFIG = CONFIG.deformation


@dataclass(frozen=True, eq=False)
class Deformed:
    """Matches of a deformed suspect: reference Gaussian of each of its M, -1 where there is none; trust in each match,
    0..1; how many alignments were weighed; and whether the maps mirror."""

    matches: Int32
    quality: Float32
    tried: int
    mirrored: bool


def unexplained(
    reference: GaussianModel,
    suspect: GaussianModel,
    matches: Int32,
    fit: Similarity,
    deviations: Deviations | None,
    floor: Deviations,
    rng: np.random.Generator,
) -> npt.NDArray[np.int64]:
    """Suspect Gaussians (n,), of a sample, for which a similarity `fit` is not the whole story; none where it is.

    Those in regions that its `matches` (M,) do not explain, or all of the sample where its errors vary smoothly over
    the suspect. `deviations` are the errors under it, None where nothing was matched.
    """
    rows = sample_rows(len(suspect), _CONFIG.glance, rng)
    if deviations is None:
        return rows
    bare = _bare(suspect, matches, rows)
    if bare.mean() > _CONFIG.region:
        return rows[bare]
    hit = rows[matches[rows] >= 0]
    wide = bool((deviations.position > 3.0 * floor.position).any())
    if wide and len(hit) > 10 * _CONFIG.neighbors:
        error = fit.apply(suspect.means[hit]) - reference.means[matches[hit]]
        length = np.linalg.norm(error, axis=1)
        right = length < 4.0 * np.median(length)
        if _common_share(suspect.means[hit[right]], error[right]) > _CONFIG.smooth:
            return rows
    return rows[:0]


def _common_share(points: Float32, errors: Float64) -> float:
    """Share of squared errors (n, 3) that neighbours have in common."""
    places = points.astype(np.float64)
    near = KdTree(places).nearest(places, _CONFIG.neighbors)[1]
    total = float(np.square(errors).sum())
    return float(np.square(errors[near].mean(axis=1)).sum()) / max(total, 1e-300)


def register_deformed(
    index: ReferenceIndex, suspect: GaussianModel, todo: Int64, rng: np.random.Generator, budget: TimeBudget = UNLIMITED
) -> Deformed | None:
    """Match a deformed suspect piece by piece, beginning at its Gaussians `todo` (n,), in no order.

    None where no patch of the suspect is one of the reference.
    """
    reference = index.model
    looks = index.looks(min(reference.sh_degree, suspect.sh_degree))
    places = scipy.spatial.cKDTree(suspect.means.astype(np.float64), balanced_tree=False, compact_nodes=False)
    patches: list[Patch] = []
    best: Deformed | None = None
    tried = 0
    for cycle in range(_CONFIG.cycles):
        if len(todo) == 0 or (cycle and not budget.allows("deformations of further parts")):
            break
        centers = todo[rng.permutation(len(todo))[: _CONFIG.patches]]
        found = find_patches(looks, suspect, places, centers, index.floor, rng)
        tried += len(centers)
        if not found:
            break
        patches += found
        same_hand = _same_hand(patches)
        pairs = (np.concatenate([p.reference for p in same_hand]), np.concatenate([p.suspect for p in same_hand]))
        middle = sorted(same_hand, key=lambda p: float(p.deviations.position.max()))[len(same_hand) // 2]
        field = grow(reference, suspect, pairs, middle.deviations, index.floor, rng)
        if field is None:
            break
        straight = field.straighten(suspect)
        neighbors = field.matcher.match(straight, Similarity.identity(), field.deviations)
        quality = field.matcher.quality(neighbors)
        matches = np.where(quality > 0, neighbors.index, -1).astype(np.int32)
        tried += field.rounds
        best = Deformed(matches, quality, tried, same_hand[0].mirrored)
        rows = sample_rows(len(suspect), _CONFIG.glance, rng)
        bare = _bare(suspect, matches, rows)
        if bare.mean() < _CONFIG.region:
            break
        todo = rows[bare]
    return best


def _same_hand(patches: list[Patch]) -> list[Patch]:
    """The patches of one hand, the one that most pairs speak for."""
    pairs = {hand: sum(len(p.suspect) for p in patches if p.mirrored == hand) for hand in (False, True)}
    mirrored = pairs[True] > _CONFIG.clearly * pairs[False]
    return [p for p in patches if p.mirrored == mirrored]


def _bare(suspect: GaussianModel, matches: Int32, rows: Int64) -> Bool:
    """Which of some Gaussians lie where hardly any of these is matched."""
    points = suspect.means[rows].astype(np.float64)
    k = min(_CONFIG.neighbors, len(rows))
    near = KdTree(points).nearest(points, k)[1]  # (n, k)
    return np.asarray((matches[rows] >= 0)[near].mean(axis=1) < 0.3)
