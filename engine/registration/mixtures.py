"""Which reference Gaussians each suspect Gaussian is made of, where it is not one of them but several in one.

Publishing tools thin a model by merging neighbours (levels of detail). A merged Gaussian is moment-matched: it has the
mass, the mean and the covariance of those it replaces. So every reference Gaussian is given to the suspect Gaussian
under which it is likeliest, and what each received must have its moments. No secret of the mark enters.

If Gaussians that were not merged gave the similarity, it is known. Otherwise it follows from the whole model: merging
keeps the mass, mean and covariance of the Gaussians that it merges, hence those of the whole model, and the principal
axes of the model give the similarity except for the signs of the axes.
"""

# mypy: allow-untyped-defs

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from engine.kernels.jit import parallel_kernel, share_of
from engine.model import Float32, Float64, GaussianModel, Int32
from engine.numerics.gaussians import covariances, surface_mass
from engine.numerics.umeyama import Similarity, umeyama
from engine.registration.config import CONFIG
from engine.registration.looks_index import ReferenceIndex
from engine.registration.match_candidates import sample_rows
from engine.registration.matching import DC_CLIP

_CONFIG = CONFIG.merging
LIMIT, COLOR_STD = CONFIG.merging.limit, CONFIG.merging.color_std


@dataclass(frozen=True, eq=False)
class Mixtures:
    """M suspect Gaussians as mixtures of reference Gaussians: E parts, each of one reference Gaussian in one suspect
    Gaussian. A plain match is a mixture of one."""

    suspect_rows: Int32  # (E,)
    reference_rows: Int32  # (E,)
    shares: Float64  # (E,) of the suspect Gaussian's mass; the shares of one add up to 1
    quality: Float32  # (M,) trust in each suspect Gaussian's mixture, 0 to 1; 0 where there is none

    @classmethod
    def of_matches(cls, matches: Int32, quality: Float32) -> "Mixtures":
        """Every suspect Gaussian is one reference Gaussian: row `matches` (M,), -1 for none; `quality` (M,)."""
        rows = np.flatnonzero((matches >= 0) & (quality > 0))
        return cls(rows.astype(np.int32), matches[rows].astype(np.int32), np.ones(len(rows)), quality)

    def explained(self, least: float = 0.0) -> npt.NDArray[np.bool_]:
        """(M,) which suspect Gaussians have parts, and more than the `least` trust."""
        return np.asarray(self.quality > least)


class Wholes:
    """Suspect Gaussians in their own frame, each as a distribution that may hold reference Gaussians."""

    def __init__(self, suspect: GaussianModel) -> None:
        self.centers = suspect.means.astype(np.float64)  # (m, 3)
        self.tree = scipy.spatial.cKDTree(self.centers, balanced_tree=False, compact_nodes=False)
        sigma = _solid(covariances(suspect))
        self.precision = np.asarray(np.linalg.inv(sigma), dtype=np.float64)  # (m, 3, 3)
        self.log_det: Float64 = np.asarray(np.linalg.slogdet(sigma)[1], dtype=np.float64)
        self.variance: Float64 = np.trace(sigma, axis1=1, axis2=2)
        self.colors = _colors(suspect)

    def find(self, parts: "Parts", fit: Similarity) -> tuple[Int32, Float64]:
        """The whole (n,) under which each part is likeliest, -1 for none, and its squared distance, infinity for none.

        `fit` takes the suspect into the reference's frame.
        """
        back = fit.inverse()
        turn = back.scale * back.R
        k = min(_CONFIG.neighbors, len(self.centers))
        points = back.apply(parts.means)
        near = np.asarray(self.tree.query(points, k=k, workers=2)[1]).reshape(len(points), k)
        sigma = turn @ parts.sigma @ turn.T
        found = np.full(len(points), -1, np.int32), np.full(len(points), np.inf)
        likeliest_wholes(
            points, sigma, parts.colors, near, self.centers, self.precision, self.log_det, self.colors, found
        )
        return found


@dataclass(frozen=True, eq=False)
class Parts:
    """n reference Gaussians as what mixtures are made of."""

    means: Float64  # (n, 3)
    sigma: Float64  # (n, 3, 3)
    colors: Float64  # (n, 3) DC, as far as 8-bit colours tell
    mass: Float64  # (n,)

    @classmethod
    def of(cls, model: GaussianModel) -> "Parts":
        """All Gaussians of a model."""
        return cls(model.means.astype(np.float64), covariances(model), _colors(model), surface_mass(model))

    def take(self, rows: npt.NDArray[np.int64]) -> "Parts":
        """The parts of some rows."""
        return Parts(self.means[rows], self.sigma[rows], self.colors[rows], self.mass[rows])


def mix(parts: Parts, suspect: GaussianModel, fit: Similarity, matches: Int32, quality: Float32) -> Mixtures:
    """The mixtures of a suspect that `fit` takes into the reference's frame.

    Suspect Gaussians that still are reference Gaussians keep their `matches` (M,), -1 for none, and `quality` (M,); the
    reference Gaussians left over are given to the suspect Gaussians left over.
    """
    alone = np.flatnonzero(matches >= 0)
    taken = np.zeros(len(parts.means), np.bool_)
    taken[matches[alone]] = True
    rows, wanting = np.flatnonzero(~taken), np.flatnonzero(matches < 0)
    trust = np.where(matches >= 0, quality, 0.0).astype(np.float32)
    if not len(rows) or not len(wanting):
        return Mixtures.of_matches(matches, trust)
    wholes = Wholes(suspect.take(wanting))
    rest = parts.take(rows)
    owner, _ = wholes.find(rest, fit)
    owned = np.flatnonzero(owner >= 0)
    owner, rest, rows = owner[owned], rest.take(owned), rows[owned]
    shares, trust[wanting] = agreement(wholes, rest, fit, owner)
    return Mixtures(
        np.concatenate([alone, wanting[owner]]).astype(np.int32),
        np.concatenate([matches[alone], rows]).astype(np.int32),
        np.concatenate([np.ones(len(alone)), shares]),
        trust,
    )


def agreement(wholes: Wholes, parts: Parts, fit: Similarity, owner: Int32) -> tuple[Float64, Float32]:
    """Share of each part in its `owner` (n,), by mass, and the trust (m,), 0 to 1, that the parts of each whole are all
    of it: their moments against its own."""
    m = len(wholes.centers)
    shares = parts.mass / np.maximum(np.bincount(owner, parts.mass, m)[owner], 1e-300)
    back = fit.inverse()
    turn = back.scale * back.R
    off = back.apply(parts.means) - wholes.centers[owner]  # (n, 3)
    mean = np.stack([np.bincount(owner, shares * column, m) for column in off.T], axis=1)
    precision = wholes.precision[owner]
    around = off - mean[owner]
    variance = np.einsum("ni,nij,nj->n", around, precision, around)
    variance += np.einsum("nij,nji->n", precision, turn @ parts.sigma @ turn.T)
    size = np.bincount(owner, shares * variance, m) / 3.0
    moved = np.einsum("ni,nij,nj->n", mean, wholes.precision, mean)
    trust = 1.0 / (1.0 + moved / _CONFIG.mean_off + np.abs(np.log(np.maximum(size, 1e-12))) / _CONFIG.size_off)
    return shares, np.where(size > 0, trust, 0.0).astype(np.float32)


@parallel_kernel
def likeliest_wholes(points, sigma, colors, near, centers, precision, log_det, whole_colors, found, call):
    """Of the candidates `near` (n, k) of each part the one under whose distribution, blurred by the part's own, it is
    likeliest; -1 where the best lies beyond the limit. And the squared distance, infinity there. Both to `found`, which
    holds -1 and infinity."""
    owner, distance2 = found
    for i in share_of(len(points), call):
        best = np.inf
        for at in range(near.shape[1]):
            j = near[i, at]
            d2 = 0.0
            for a in range(3):
                ga = points[i, a] - centers[j, a]
                for b in range(3):
                    d2 += precision[j, a, b] * (ga * (points[i, b] - centers[j, b]) + sigma[i, a, b])
            apart = 0.0
            for c in range(3):
                apart += (colors[i, c] - whole_colors[j, c]) ** 2
            cost = d2 + log_det[j] + apart / (COLOR_STD * COLOR_STD)
            if cost < best:
                best = cost
                owner[i], distance2[i] = j, d2
        if not distance2[i] <= LIMIT:
            owner[i], distance2[i] = -1, np.inf


def _solid(sigma: Float64) -> Float64:
    """Covariances (n, 3, 3) with an inverse, discs made a little thick."""
    return np.asarray(sigma + (_CONFIG.thin * np.trace(sigma, axis1=1, axis2=2)[:, None, None] + 1e-300) * np.eye(3))


def _colors(model: GaussianModel) -> Float64:
    return np.clip(model.sh[:, 0].astype(np.float64), -DC_CLIP, DC_CLIP)


Singles = tuple[Int32, Float32]
"""Reference row (or -1) of each suspect Gaussian, and the trust in it."""


@dataclass(frozen=True, eq=False)
class Merged:
    """A placement under which the suspect's Gaussians are mixtures, the plain matches among them (M,), and how many
    placements were weighed."""

    fit: Similarity
    matches: Int32
    quality: Float32
    mixtures: Mixtures
    tried: int

    @property
    def explained(self) -> float:
        """Mean trust in the mixtures of what has no plain match; 0 where all have one."""
        wanting = self.matches < 0
        return float(self.mixtures.quality[wanting].mean()) if wanting.any() else 0.0


def register_merged(
    index: ReferenceIndex,
    suspect: GaussianModel,
    start: Similarity | None,
    turns: list[Float64],
    rng: np.random.Generator,
    singles: Singles | None = None,
) -> Merged | None:
    """The suspect as mixtures of the reference; None where they explain too little.

    `start` is the similarity where it is known already, and `singles` the plain matches under it; else the reference's
    own frame is tried, turned by each of `turns`, and the axes of both models.
    """
    parts = Parts.of(index.model)
    if start is not None:
        return _judged(index, parts, suspect, start, 1, singles)
    wholes = Wholes(suspect)
    glance, sample = (parts.take(sample_rows(len(parts.means), n, rng)) for n in (_CONFIG.glance, _CONFIG.sample))
    in_frame = [Similarity(1.0, turn, np.zeros(3)) for turn in turns]
    tried = 0
    for fits, moved in ((in_frame, False), (_by_axes(parts, Parts.of(suspect)), True)):
        if not fits:
            continue
        tried += len(fits)
        best = max(fits, key=lambda fit: _evidence(wholes, glance, fit, index.extent))
        if moved:
            best = _refined(wholes, sample, best, index.extent)
        if _promise(wholes, parts, best, rng) > _CONFIG.promising:
            merged = _judged(index, parts, suspect, best, tried)
            if merged is not None:
                return merged
    return None


def _promise(wholes: Wholes, parts: Parts, fit: Similarity, rng: np.random.Generator) -> float:
    """Mean trust in the mixtures of a few suspect Gaussians and their neighbours; parts elsewhere are left out."""
    spots = wholes.centers[sample_rows(len(wholes.centers), _CONFIG.spots, rng)]
    distance, around = wholes.tree.query(spots, k=min(_CONFIG.around, len(wholes.centers)))
    reach, spot = scipy.spatial.cKDTree(spots).query(fit.inverse().apply(parts.means), workers=2)
    near = parts.take(np.flatnonzero(reach < 2.0 * distance.reshape(len(spots), -1)[spot, -1]))
    owner, _ = wholes.find(near, fit)
    inside = np.flatnonzero(owner >= 0)
    trust = agreement(wholes, near.take(inside), fit, owner[inside])[1]
    return float(trust[np.unique(around)].mean())


def _judged(
    index: ReferenceIndex,
    parts: Parts,
    suspect: GaussianModel,
    start: Similarity,
    tried: int,
    singles: Singles | None = None,
) -> Merged | None:
    """The mixtures under a placement, or a better one that follows from them; None where they explain too little."""
    mixed = _mixed(index, parts, suspect, start, tried, singles)
    if mixed.explained <= _CONFIG.least:
        return None
    better = _polished(parts, suspect, mixed)
    if better is not None and _moved(mixed.fit, better, suspect.means) > _CONFIG.close * index.extent:
        again = _mixed(index, parts, suspect, better, tried)
        mixed = again if again.mixtures.quality.sum() > mixed.mixtures.quality.sum() else mixed
    return mixed


def _mixed(
    index: ReferenceIndex,
    parts: Parts,
    suspect: GaussianModel,
    fit: Similarity,
    tried: int,
    singles: Singles | None = None,
) -> Merged:
    matches, quality = index.matcher.pair(suspect, fit) if singles is None else singles
    return Merged(fit, matches, quality, mix(parts, suspect, fit, matches, quality), tried)


def _by_axes(parts: Parts, wholes: Parts) -> list[Similarity]:
    """The similarities that take mean and covariance of the whole suspect to the reference's: four, for an axis has no
    direction."""
    (center_a, values_a, axes_a), (center_b, values_b, axes_b) = _axes(wholes), _axes(parts)
    if not (values_a[0] > 0 and values_b[0] > 0):
        return []
    scale = float(np.sqrt(values_b.sum() / values_a.sum()))
    fits = []
    for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        R = (axes_b * np.array(signs)) @ axes_a.T
        fits.append(Similarity(scale, R, center_b - scale * R @ center_a))
    return fits


def _axes(parts: Parts) -> tuple[Float64, Float64, Float64]:
    """Mean (3,), variances (3,) and axes (3, 3), right-handed columns, of a model as one distribution."""
    share = parts.mass / max(parts.mass.sum(), 1e-300)
    center = share @ parts.means
    gap = parts.means - center
    sigma = np.einsum("n,nij->ij", share, parts.sigma) + (gap * share[:, None]).T @ gap
    values, vectors = np.linalg.eigh(sigma)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))
    return center, values, vectors


def _evidence(wholes: Wholes, parts: Parts, fit: Similarity, extent: float) -> float:
    """Mean log likelihood ratio of parts, nats: as the wholes they went into, against anywhere in the reference.

    Closeness alone would reward large scales, under which a piece covers everything.
    """
    owner, distance2 = wholes.find(parts, fit)
    inside = owner >= 0
    log_det = wholes.log_det[owner[inside]] + 6.0 * np.log(fit.scale)
    ratio = 0.5 * (6.0 * np.log(extent) - log_det - distance2[inside])
    return float(np.maximum(ratio, 0.0).sum()) / max(1, len(owner))


def _refined(wholes: Wholes, parts: Parts, fit: Similarity, extent: float) -> Similarity:
    """The placement at which parts surround the wholes they are likeliest in: each pulls its whole to itself, and what
    lies on one side cancels what lies on the other."""
    weight = 1.0 / wholes.variance
    for _ in range(_CONFIG.rounds):
        owner, _ = wholes.find(parts, fit)
        rows = np.flatnonzero(owner >= 0)
        better = umeyama(wholes.centers[owner[rows]], parts.means[rows], weight[owner[rows]])
        if better is None:
            break
        settled = _moved(fit, better, wholes.centers) < _CONFIG.settled * extent
        fit = better
        if settled:
            break
    return fit


def _moved(fit: Similarity, better: Similarity, points: npt.NDArray[Any]) -> float:
    """Largest distance along an axis between where two placements put some of the points (n, 3)."""
    some = points[:: max(1, len(points) // 100)]
    return float(np.abs(better.apply(some) - fit.apply(some)).max())


def _polished(parts: Parts, suspect: GaussianModel, mixed: Merged) -> Similarity | None:
    """The similarity under which the wholes' centres are the means of their parts, by those that agree."""
    mixtures, m = mixed.mixtures, len(suspect)
    rows = mixtures.reference_rows
    mean = np.stack(
        [np.bincount(mixtures.suspect_rows, mixtures.shares * parts.means[rows, c], m) for c in range(3)], axis=1
    )
    trust = np.where(mixtures.quality > 3 * _CONFIG.trusted, mixtures.quality.astype(np.float64), 0.0)
    size = np.exp(suspect.log_scales.astype(np.float64).mean(axis=1))
    return umeyama(suspect.means, mean, trust / np.maximum(size, 1e-12) ** 2)
