"""Registration of a suspect whose Gaussians are merged ones (`mixtures`): hardly any is one of the reference's.

Where unmerged Gaussians gave the similarity, it is known. Else merging helps: it keeps mass, mean and
covariance of whatever is merged, so those of the whole model, too, and their axes give the similarity but for signs.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from engine.model import Float32, Float64, GaussianModel, Int32
from engine.numerics.umeyama import Similarity, umeyama
from engine.registration.config import CONFIG
from engine.registration.looks_index import ReferenceIndex
from engine.registration.match_candidates import sample_rows
from engine.registration.mixtures import Mixtures, Parts, Wholes, agreement, mix

_CONFIG = CONFIG.merging


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
