"""From a few matched pieces of a deformed suspect to all of it: a field of affine maps that grows.

1. Nodes all over the suspect. Those among matched Gaussians get the affine map of their nearest matches.
2. What lies about these nodes is moved into the reference's frame by their blended maps, and matched there.
3. A node whose surroundings are explained hands its map on: the next ones start from it. Until nothing is added.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from engine.model import Bool, Float64, GaussianModel, Int32, Int64
from engine.numerics.umeyama import Similarity
from engine.registration.config import CONFIG
from engine.registration.match_candidates import sample_rows
from engine.registration.matching import Deviations, Matcher, estimate_deviations, paired
from engine.registration.warp import Affine, blend, fit_affine, unturned, warped

_CONFIG = CONFIG.deformation


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
    measured = _measure(reference, moved, paired(neighbors), floor)
    return Field(nodes, maps, explained, Matcher(reference, measured), measured, rounds)


def _measure(
    reference: GaussianModel, straight: GaussianModel, pairs: tuple[Int32, Int64], floor: Deviations
) -> Deviations:
    """Errors of a straightened suspect. Joints and edges leave a few large ones in position: those count."""
    step = max(1, len(pairs[0]) // _CONFIG.measured)
    pairs = (pairs[0][::step], pairs[1][::step])
    usual = unturned(estimate_deviations(reference, straight, pairs, Similarity.identity(), floor))
    error = np.abs(straight.means[pairs[1]].astype(np.float64) - reference.means[pairs[0]])
    # 1.645: nine in ten of a normal error are smaller
    return replace(usual, position=np.maximum(usual.position, np.quantile(error, 0.9, axis=0) / 1.645))


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
