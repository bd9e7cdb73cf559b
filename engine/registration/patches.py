"""Small patches of a deformed suspect, each laid over the reference by an affine map of its own.

Where no similarity holds, what a deformation leaves alone still tells Gaussians apart: opacity, base colour, and the
energy of each SH degree. Neighbours in the suspect whose look-alikes are neighbours in the reference, and lie there
as one affine map says, are no accident.

1. A patch: the Gaussians nearest to one of the suspect's.
2. Look-alikes of each of them in the reference; pairs whose look-alikes crowd together.
3. Four pairs make an affine map; the one that explains most of the crowd is refined.
4. The map must explain the patch in position, size, opacity and colour, far better than the same map turned does.

Nothing here knows the secret of the mark: only the unmarked reference and the suspect enter.
"""

from __future__ import annotations  # those that name SciPy's modules would load them

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from engine.model import Float64, GaussianModel, Int64
from engine.numerics.similarity import quaternion_to_rotation
from engine.numerics.umeyama import Similarity
from engine.registration.agreement import beats_decoys
from engine.registration.config import CONFIG
from engine.registration.matching import DC_CLIP, Deviations, Matcher, estimate_deviations

_CONFIG = CONFIG.patches


Affine = npt.NDArray[np.float64]
"""(..., 3, 4): x_target = map[..., :3] @ x_source + map[..., 3]."""


def fit_affine(source: Float64, target: Float64, prior: Affine) -> Affine:
    """Robust affine maps (B, 3, 4) of batches of paired points (B, n, 3) (Geman-McClure), held to a prior where the
    pairs tell nothing.

    `prior` (B, 3, 4) are roughly right maps; their linear part, turned as the pairs say, fills in what a flat piece
    leaves open.
    """
    w, current = np.ones(source.shape[:2]), prior
    for turn in range(CONFIG.deformation.reweightings):
        total = np.maximum(w.sum(axis=1), 1e-12)[:, None]
        a = np.einsum("bn,bni->bi", w, source) / total  # (B, 3)
        b = np.einsum("bn,bni->bi", w, target) / total  # (B, 3)
        da, db = source - a[:, None], target - b[:, None]
        spread = np.einsum("bn,bni,bnj->bij", w, da, da) / total[..., None]  # (B, 3, 3)
        cross = np.einsum("bn,bni,bnj->bij", w, db, da) / total[..., None]  # (B, 3, 3)
        linear = _turned(prior[:, :, :3], cross, spread)
        hold = CONFIG.deformation.ridge * np.trace(spread, axis1=1, axis2=2)[:, None, None] / 3.0 + 1e-30
        solved = np.linalg.solve(
            spread + hold * np.eye(3), np.swapaxes(cross + hold * linear, 1, 2)
        )  # symmetric: the transposed equation
        A = np.swapaxes(solved, 1, 2)
        current = np.concatenate([A, (b - np.einsum("bij,bj->bi", A, a))[..., None]], axis=2)  # (B, 3, 4)
        if turn == CONFIG.deformation.reweightings - 1:
            break
        error = np.linalg.norm(apply(current[:, None], source) - target, axis=2)
        median = np.sort(error, axis=1)[:, [(error.shape[1] - 1) // 2]]  # (B, 1)
        scale = np.maximum(2.0 * median, 1e-9 * np.sqrt(hold[..., 0]))
        w = 1.0 / np.square(1.0 + np.square(error / scale))
    return current


def _turned(linear: Float64, cross: Float64, spread: Float64) -> Float64:
    """The prior's linear parts (B, 3, 3), turned by the rotation that fits them best to the pairs."""
    u, _, vt = np.linalg.svd(cross @ np.swapaxes(linear, 1, 2))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return np.asarray(u @ vt @ linear)


def apply(maps: Affine, points: npt.NDArray[np.floating]) -> Float64:
    """Points (..., 3) under maps (..., 3, 4)."""
    return (maps[..., :3] @ points.astype(np.float64)[..., None])[..., 0] + maps[..., 3]


def warped(model: GaussianModel, maps: Affine) -> GaussianModel:
    """Gaussians moved by an affine map each (N, 3, 4): centres, and covariances as A Sigma A^T.

    Log scales come in descending order; quaternions and colours stay as they were, so it is no use for rendering.
    """
    axes = (maps[:, :, :3] @ quaternion_to_rotation(model.quats)) * np.exp(model.log_scales.astype(np.float64))[:, None]
    squares = np.linalg.eigvalsh(axes @ np.swapaxes(axes, 1, 2))
    return model.with_(means=apply(maps, model.means), log_scales=0.5 * np.log(np.maximum(squares[:, ::-1], 1e-30)))


def blend(nodes: npt.NDArray[np.floating], maps: Affine, points: npt.NDArray[np.floating], near: int = 4) -> Affine:
    """Maps (N, 3, 4) at points (N, 3), from those (A, 3, 4) at the `near` nearest of the nodes (A, 3)."""
    near = min(near, len(nodes))
    distance, index = scipy.spatial.cKDTree(nodes).query(points, k=near, workers=2)
    distance, index = distance.reshape(-1, near), index.reshape(-1, near)  # (N, near)
    reach = np.maximum(distance[:, -1:], 1e-30)
    weights = np.square(1.0 - np.square(0.999 * distance / reach))
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("nk,nkij->nij", weights, maps[index]))  # (N, 3, 4)


def unturned(deviations: Deviations) -> Deviations:
    """The warped model without rotations: the axes of a deformed ellipsoid cannot be matched."""
    return replace(deviations, rotation=np.inf)


class Looks:
    """The reference laid out by what deformations leave alone, SH energies up to `degree`."""

    def __init__(self, reference: GaussianModel, degree: int) -> None:
        self.reference, self.degree = reference, degree
        self._sparse: dict[int, scipy.spatial.cKDTree] = {}

    @cached_property
    def tree(self) -> scipy.spatial.cKDTree:
        return scipy.spatial.cKDTree(_looks(self.reference, self.degree), balanced_tree=False, compact_nodes=False)

    def radii(self, places: Float64, count: int) -> Float64:
        """(n,) about how far around each of `places` (n, 3) the nearest `count` reference Gaussians reach."""
        step = max(1, count // _CONFIG.counted)
        if step not in self._sparse:
            some = self.reference.means[::step].astype(np.float64)
            self._sparse[step] = scipy.spatial.cKDTree(some, balanced_tree=False, compact_nodes=False)
        tree = self._sparse[step]
        return np.asarray(tree.query(places, k=[min(max(1, count // step), tree.n)], workers=2)[0]).reshape(-1)


def _looks(model: GaussianModel, degree: int) -> Float64:
    """(n, F) opacity logit, DC and energy of each SH degree, each over about its error after a re-export and a mark."""
    logits = np.clip(model.opacity_logits.astype(np.float64), -CONFIG.looks.logit_clip, CONFIG.looks.logit_clip)
    sh = model.sh.astype(np.float64)
    columns = [logits / 0.15, *(np.clip(sh[:, 0], -DC_CLIP, DC_CLIP).T / 0.05)]
    for l in range(1, degree + 1):
        columns.append(np.sqrt(np.square(sh[:, l * l : (l + 1) ** 2]).sum(axis=(1, 2))) / 0.05)
    return np.stack(columns, axis=1)  # (n, F)


@dataclass(frozen=True, eq=False)
class Patch:
    """A piece of the suspect and where it belongs: pairs (n,), (n,) that an affine map (3, 4) of suspect into reference
    explains, and their errors. The map of a mirror image mirrors."""

    suspect: Int64
    reference: Int64
    map: Affine
    deviations: Deviations

    @property
    def mirrored(self) -> bool:
        """Whether the map turns left into right."""
        return bool(np.linalg.det(self.map[:, :3]) < 0)


def find_patches(
    looks: Looks,
    suspect: GaussianModel,
    places: scipy.spatial.cKDTree,
    centers: npt.NDArray[np.int64],
    floor: Deviations,
    rng: np.random.Generator,
) -> list[Patch]:
    """Patches about Gaussians `centers` (c,) that have a place in the reference; none where the suspect is another
    scene. A flat one may have a place both as it is and mirrored, and is listed for each.

    `places` is the tree of the suspect's centres, `floor` the errors below which nothing is measured.
    """
    count = min(_CONFIG.size, len(suspect))
    found = []
    for center in centers:
        rows = np.asarray(places.query(suspect.means[center], k=count)[1], dtype=np.int64).reshape(-1)
        found += _find_patch(looks, suspect, np.sort(rows), floor, rng)
    return found


def _find_patch(
    looks: Looks, suspect: GaussianModel, rows: Int64, floor: Deviations, rng: np.random.Generator
) -> list[Patch]:
    part = suspect.take(rows)
    reference = looks.reference
    k = min(_CONFIG.look_alikes, len(reference))
    near = np.asarray(looks.tree.query(_looks(part, looks.degree), k=k)[1]).reshape(len(rows), k)  # (n, k)
    source_rows = np.repeat(np.arange(len(rows)), k)
    target = near.reshape(-1).astype(np.int64)
    x, y = part.means[source_rows].astype(np.float64), reference.means[target].astype(np.float64)
    # As many reference Gaussians as the patch has, were the models equally dense: no scale needs to be known.
    crowd = min(int(1.5 * len(rows) * max(1.0, len(reference) / len(suspect))), len(reference))
    best: dict[int, tuple[int, Affine, float, npt.NDArray[np.bool_]]] = {}
    for crowd_pairs, radius in _crowds(looks, y, source_rows, crowd):
        drawn = _draw(x, y, source_rows, crowd_pairs, _CONFIG.tolerance * radius, rng)
        for hand, (count, map_, inlying) in drawn.items():
            if hand not in best or count > best[hand][0]:
                best[hand] = (count, map_, radius, inlying)
    patches = []
    for count, map_, radius, inlying in best.values():
        if count >= _CONFIG.least_pairs + 4:
            pairs = (target[inlying], source_rows[inlying])
            patches.append(_verify(reference, suspect, rows, map_, pairs, radius, floor, rng))
    return [patch for patch in patches if patch is not None]


def _crowds(looks: Looks, y: Float64, source_rows: Int64, crowd: int) -> list[tuple[Int64, float]]:
    """Where look-alikes crowd together: the pairs there, and the radius of the reference about them."""
    first = np.flatnonzero(np.diff(source_rows, prepend=-1))  # the best look-alike of each Gaussian
    middles = y[first]
    radii = looks.radii(middles, crowd)
    distance2 = np.square(middles).sum(axis=1)[:, None] + np.square(y).sum(axis=1) - 2.0 * (middles @ y.T)
    near = distance2 <= np.square(radii)[:, None]  # (Q, P)
    # pairs of one Gaussian are one witness
    support = near.reshape(len(first), len(first), -1).any(axis=2).sum(axis=1)  # (Q,)
    chosen: list[tuple[Int64, float]] = []
    taken = np.zeros(len(first), dtype=bool)
    for i in np.argsort(-support, kind="stable"):
        if support[i] < _CONFIG.least_pairs + 4 or len(chosen) == _CONFIG.crowds:
            break
        if not taken[i] and radii[i] > 0:
            chosen.append((np.flatnonzero(near[i]), float(radii[i])))
            taken |= near[i, first]
    return chosen


def _draw(
    x: Float64, y: Float64, source_rows: Int64, crowd_pairs: Int64, tolerance: float, rng: np.random.Generator
) -> dict[int, tuple[int, Affine, npt.NDArray[np.bool_]]]:
    """The affine map of four pairs of a crowd that explains most of it, after a refinement on those: the best that
    keeps left and right (1), and the best that mirrors (-1)."""
    a, b, names = x[crowd_pairs], y[crowd_pairs], source_rows[crowd_pairs]
    picks = rng.integers(len(crowd_pairs), size=(_CONFIG.draws, 4))
    edges = a[picks[:, 1:]] - a[picks[:, :1]]  # (D, 3, 3)
    spread = float(np.sqrt(np.square(a - a.mean(axis=0)).sum(axis=1).mean()))
    # flatter tetrahedra than this determine nothing across them
    fit = np.abs(np.linalg.det(edges)) > 1e-3 * spread**3
    edges, base = edges[fit], picks[fit]
    if not len(edges):
        return {}
    A = np.swapaxes(np.linalg.solve(edges, b[base[:, 1:]] - b[base[:, :1]]), 1, 2)  # (D, 3, 3)
    stretch = np.linalg.svd(A, compute_uv=False)
    believable = stretch[:, 0] < _CONFIG.most_skewed * stretch[:, 2]
    A, base = A[believable], base[believable]
    hands = np.sign(np.linalg.det(A))
    t = b[base[:, 0]] - np.einsum("dij,dj->di", A, a[base[:, 0]])  # (D, 3)
    error2 = np.square(np.einsum("dij,nj->dni", A, a) + t[:, None] - b).sum(axis=2)  # (D, n)
    support = (error2 < tolerance**2).sum(axis=1)
    found = {}
    for hand in (1, -1):
        if not (hands == hand).any():
            continue
        best = int(np.argmax(np.where(hands == hand, support, -1)))
        map_: Affine = np.concatenate([A[best], t[best][:, None]], axis=1)  # (3, 4)
        refined = _refined(a, b, names, map_, tolerance)
        if refined is not None:
            map_, inlying = refined
            everyone = np.zeros(len(x), dtype=bool)
            everyone[crowd_pairs[inlying]] = True
            found[hand] = len(np.unique(names[inlying])), map_, everyone
    return found


def _refined(
    a: Float64, b: Float64, names: Int64, map_: Affine, tolerance: float
) -> tuple[Affine, npt.NDArray[np.bool_]] | None:
    """A map fitted to the pairs (n, 3), (n, 3) that it explains, and which those are; None where they are too few."""
    for _ in range(3):
        inlying = np.square(a @ map_[:, :3].T + map_[:, 3] - b).sum(axis=1) < tolerance**2
        if len(np.unique(names[inlying])) < 8:
            return None
        map_ = fit_affine(a[inlying][None], b[inlying][None], map_[None])[0]
    return map_, np.square(a @ map_[:, :3].T + map_[:, 3] - b).sum(axis=1) < tolerance**2


def _verify(
    reference: GaussianModel,
    suspect: GaussianModel,
    rows: Int64,
    map_: Affine,
    pairs: tuple[Int64, Int64],
    radius: float,
    floor: Deviations,
    rng: np.random.Generator,
) -> Patch | None:
    """The patch, if its map explains far more of it in every respect than the same map turned about does."""
    same = Similarity.identity()
    part = suspect.take(rows)
    around = np.flatnonzero(
        np.square(reference.means - reference.means[pairs[0]].mean(axis=0)).sum(axis=1) < (3.0 * radius) ** 2
    )
    nearby = reference.take(around)
    local = np.searchsorted(around, pairs[0])
    inside = (local < len(around)) & (around[np.minimum(local, len(around) - 1)] == pairs[0])
    pairs = (local[inside], pairs[1][inside])
    for _ in range(2):
        moved = warped(part, np.broadcast_to(map_, (len(rows), 3, 4)))
        deviations = unturned(estimate_deviations(nearby, moved, pairs, same, floor))
        matcher = Matcher(nearby, deviations)
        hit = matcher.match(moved, same, deviations).pairs
        pairs = (hit[0].astype(np.int64), hit[1])
        if len(np.unique(pairs[0])) < max(_CONFIG.least_pairs, _CONFIG.least_share * len(rows)):
            return None
        x, y = part.means[pairs[1]].astype(np.float64), nearby.means[pairs[0]].astype(np.float64)
        map_ = fit_affine(x[None], y[None], map_[None])[0]
    moved = warped(part, np.broadcast_to(map_, (len(rows), 3, 4)))
    if not beats_decoys(nearby, moved, matcher, same, deviations, rng, 3.0, float(_CONFIG.least_pairs)):
        return None
    return Patch(rows[pairs[1]], around[pairs[0]].astype(np.int64), map_, deviations)
