"""Registration of a suspect that no single similarity explains: bent, twisted, squashed, or posed.

It runs only where the similarity leaves whole regions unexplained, or errs by a smooth amount. Patches are found
where nothing is explained yet (`patches`), and a field of affine maps grows from them:

1. Nodes all over the suspect. Those among matched Gaussians get the affine map of their nearest matches.
2. What lies about these nodes is moved into the reference's frame by their blended maps, and matched there.
3. A node whose surroundings are explained hands its map on: the next ones start from it. Until nothing is added.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from engine.model import Bool, Float32, Float64, GaussianModel, Int32, Int64
from engine.numerics.kd_tree import KdTree
from engine.numerics.time_budget import UNLIMITED, TimeBudget
from engine.numerics.umeyama import Similarity
from engine.registration.config import CONFIG
from engine.registration.looks_index import ReferenceIndex
from engine.registration.match_candidates import sample_rows
from engine.registration.matching import Deviations, Matcher, estimate_wide
from engine.registration.patches import Affine, Patch, blend, find_patches, fit_affine, unturned, warped


@dataclass(frozen=True, eq=False)
class Field:
    """Where a deformed suspect belongs.

    `nodes` (A, 3) are places in the suspect, `maps` (A, 3, 4) the affine map into the reference's frame at each,
    `explained` (A,) whether the reference explains what lies about each. `matcher` lays the reference out for the
    errors that remain, `deviations`, with the global change of colour.
    """

    nodes: Float64
    maps: Affine
    explained: Bool
    matcher: Matcher
    deviations: Deviations
    rounds: int

    def straighten(self, suspect: GaussianModel) -> GaussianModel:
        """The suspect in the reference's frame."""
        fitted = np.flatnonzero(self.explained)
        return warped(suspect, blend(self.nodes[fitted], self.maps[fitted], suspect.means))


def grow(
    reference: GaussianModel,
    suspect: GaussianModel,
    pairs: tuple[Int64, Int64],
    deviations: Deviations,
    floor: Deviations,
    rng: np.random.Generator,
) -> Field | None:
    """Extend matched pairs over the suspect, as far as the reference goes; None where not even the pairs hold together.

    `pairs` are reference and suspect indices (n,), nearly all of them right, `deviations` their errors after local
    maps, `floor` those below which nothing is measured.
    """
    rows = sample_rows(len(suspect), _CONFIG.sample, rng)
    part = suspect.take(rows)
    points = part.means.astype(np.float64)
    nodes = points[np.sort(rng.choice(len(points), min(_CONFIG.nodes, len(points)), replace=False))]
    tree = scipy.spatial.cKDTree(nodes)
    home = np.asarray(tree.query(points, workers=2)[1])
    spacings = np.asarray(tree.query(nodes, k=min(7, len(nodes)))[0]).reshape(len(nodes), -1)  # (A, 7)
    reach = 2.5 * np.median(spacings[:, 1:], axis=1) if spacings.shape[1] > 1 else np.full(len(nodes), np.inf)

    same = Similarity.identity()
    deviations = unturned(deviations)
    source, target = suspect.means[pairs[1]].astype(np.float64), reference.means[pairs[0]].astype(np.float64)
    first = _first_map(source, target)
    maps, fitted = np.broadcast_to(first, (len(nodes), 3, 4)).copy(), np.zeros(len(nodes), dtype=bool)
    # A map handed on is wrong by the field's bend over one node; the errors in size and look still show that.
    step = float(np.median(spacings)) * float(np.cbrt(abs(np.linalg.det(first[:, :3]))))
    matcher = Matcher(reference, replace(deviations, position=np.maximum(deviations.position, _CONFIG.bend * step)))
    members = np.bincount(home, minlength=len(nodes))
    rounds, last = 0, -1
    while rounds < _CONFIG.rounds:
        rounds += 1
        fitted, maps = _fit_nodes(nodes, maps, fitted, reach, source, target)
        if not fitted.any():
            return None
        use = fitted[home]
        moved = warped(part.take(use), blend(nodes[fitted], maps[fitted], points[use]))
        neighbors = matcher.match(moved, same, deviations)
        hit = np.flatnonzero(neighbors.index >= 0)
        trust = neighbors.probability[hit]
        used = np.flatnonzero(use)
        weight = np.bincount(home[used[hit]], trust, len(nodes))
        explained = fitted & (weight > _CONFIG.explained * members) & (weight > 2.0)
        sure = hit[(trust > 0.5) & explained[home[used[hit]]]]
        if len(sure) < 16:
            return None
        source = points[used[sure]]
        target = reference.means[neighbors.index[sure]].astype(np.float64)
        if len(sure) <= 1.004 * last:
            break
        last = len(sure)
        fitted = explained
    measured = _measure(reference, moved, neighbors.pairs, floor)
    return Field(nodes, maps, explained, Matcher(reference, measured), measured, rounds)


def _measure(
    reference: GaussianModel, straight: GaussianModel, pairs: tuple[Int32, Int64], floor: Deviations
) -> Deviations:
    """Errors of a straightened suspect. Joints and edges leave a few large ones in position: those count."""
    step = max(1, len(pairs[0]) // _CONFIG.measured)
    pairs = (pairs[0][::step], pairs[1][::step])
    return unturned(estimate_wide(reference, straight, pairs, Similarity.identity(), floor))


def _first_map(source: Float64, target: Float64) -> Affine:
    """One map for all, as a prior for the first fits: of least squares."""
    design = np.concatenate([source, np.ones((len(source), 1))], axis=1)  # (n, 4)
    solution = np.linalg.lstsq(design, target, rcond=None)[0]
    return np.asarray(solution.T)


def _fit_nodes(
    nodes: Float64, maps: Affine, fitted: Bool, reach: Float64, source: Float64, target: Float64
) -> tuple[Bool, Affine]:
    """Maps of all nodes that have matches within reach, from their nearest ones; others keep what they had."""
    k = min(_CONFIG.node_pairs, len(source))
    distance, index = scipy.spatial.cKDTree(source).query(nodes, k=k, workers=2)
    distance, index = distance.reshape(-1, k), index.reshape(-1, k)  # (A, k)
    near = distance[:, min(7, k - 1)] < reach
    prior = maps[near]
    fresh = ~fitted[near]
    if fresh.any() and fitted.any():
        old = np.flatnonzero(fitted)
        prior[fresh] = maps[old[np.asarray(scipy.spatial.cKDTree(nodes[old]).query(nodes[near][fresh])[1])]]
    chosen = index[near]
    out = maps.copy()
    out[near] = fit_affine(source[chosen], target[chosen], prior)
    return near, out


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
        matches, quality = field.matcher.pair(straight, Similarity.identity(), field.deviations)
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
