"""Candidate pairs for the registration: Gaussians that look alike whatever similarity was applied."""

# mypy: allow-untyped-defs

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from engine.kernels.jit import parallel_kernel, share_of
from engine.model import Float64, GaussianModel, Int64
from engine.numerics.kd_tree import KdTree
from engine.numerics.similarity import MIRROR
from engine.registration.config import CONFIG
from engine.registration.matching import DC_CLIP, FLATNESS_CLIP, LOGIT_CLIP

SHAPE_FEATURES = 3
"""Two size ratios and the opacity come first in a feature vector, then colour, then SH energies."""


def invariant_features(model: GaussianModel, index: npt.NDArray[np.int64] | slice, degree: int) -> Float64:
    """(n, F) features that no similarity changes: size ratios, opacity logit, DC, energy per SH degree."""
    log_scales, logits, sh = model.log_scales[index], model.opacity_logits[index], model.sh[index]
    out = np.empty((len(logits), SHAPE_FEATURES + 3 + degree))
    _features(log_scales, logits, sh, degree, out)
    return out


@parallel_kernel
def _features(log_scales, logits, sh, degree, out, call):
    for i in share_of(len(out), call):
        s0, s1, s2 = log_scales[i, 0], log_scales[i, 1], log_scales[i, 2]
        top, bottom = max(s0, max(s1, s2)), min(s0, min(s1, s2))
        middle = max(min(s0, s1), min(max(s0, s1), s2))
        out[i, 0] = min(np.float64(top) - middle, FLATNESS_CLIP)
        out[i, 1] = min(np.float64(top) - bottom, FLATNESS_CLIP)
        out[i, 2] = min(max(np.float64(logits[i]), -LOGIT_CLIP), LOGIT_CLIP)
        for c in range(3):
            out[i, 3 + c] = min(max(np.float64(sh[i, 0, c]), -DC_CLIP), DC_CLIP)
        for l in range(1, degree + 1):
            energy = 0.0
            for k in range(l * l, (l + 1) * (l + 1)):
                for c in range(3):
                    energy += np.float64(sh[i, k, c]) * np.float64(sh[i, k, c])
            out[i, 5 + l] = math.sqrt(energy)


@dataclass(frozen=True, eq=False)
class Candidates:
    """n pairs of Gaussians that look alike, each suspect and each reference Gaussian at most once.

    `reference` and `suspect` (n,) are indices, `x` and `y` (n, 3) the suspect's and the reference's positions; `size`
    (n,) is the log of the reference's size over the suspect's: a vote for the log of the scale.
    """

    reference: Int64
    suspect: Int64
    x: Float64
    y: Float64
    size: Float64

    def __len__(self) -> int:
        return len(self.x)

    def take(self, keep: npt.NDArray[np.bool_]) -> "Candidates":
        """The pairs under a mask."""
        return Candidates(self.reference[keep], self.suspect[keep], self.x[keep], self.y[keep], self.size[keep])

    def mirrored(self) -> "Candidates":
        """The pairs of the suspect's mirror image: no look knows left from right."""
        return replace(self, x=self.x * MIRROR)


def log_sizes(model: GaussianModel, index: npt.NDArray[np.int64]) -> Float64:
    """(n,) mean of the two larger log scales: the smallest is often clipped or plain noise."""
    s = np.sort(model.log_scales[index].astype(np.float64), axis=1)
    return np.asarray(0.5 * (np.maximum(s[:, 1], s[:, 2] - FLATNESS_CLIP) + s[:, 2]))


class FeatureIndex:
    """The reference's rarest Gaussians in feature space (SH energies up to `degree`, DC if `colors`),
    ready for queries."""

    def __init__(self, reference: GaussianModel, degree: int, *, colors: bool) -> None:
        self.reference, self.degree, self.colors = reference, degree, colors
        features = self._columns(invariant_features(reference, slice(None), degree))
        step = max(1, len(features) // 20_000)
        sample = features[::step].copy()
        self.center = np.median(sample, axis=0)
        deviation = 1.4826 * np.median(np.abs(sample - self.center), axis=0)
        self.scale = np.maximum(np.maximum(deviation, 0.3 * sample.std(axis=0)), 1e-3)
        white = self._whiten(features)
        covariance = np.cov(white[::step].T) if len(sample) > 1 else np.eye(white.shape[1])
        self.precision = np.linalg.inv(np.atleast_2d(covariance) + 0.01 * np.eye(white.shape[1]))
        rarity = self._rarity(white)
        self.all_points = white
        if len(white) > CONFIG.looks.tree_points:
            rank = len(white) - CONFIG.looks.tree_points
            self.threshold = float(np.partition(rarity, rank)[rank])
        else:
            self.threshold = -np.inf
        self.rows = np.flatnonzero(rarity >= self.threshold)

    @cached_property
    def rare_tree(self) -> KdTree:
        return KdTree(self.all_points[self.rows])

    @cached_property
    def full_tree(self) -> KdTree:
        return KdTree(self.all_points)

    def _columns(self, features: Float64) -> Float64:
        if self.colors:
            return features
        return np.delete(features, np.s_[SHAPE_FEATURES : SHAPE_FEATURES + 3], axis=1)

    def _whiten(self, features: Float64) -> Float64:
        """The features over their spread, in place: of all Gaussians they are large."""
        features -= self.center
        features /= self.scale
        return np.clip(features, -5.0, 5.0, out=features)

    def _rarity(self, white: Float64) -> Float64:
        """Squared Mahalanobis distance from the reference's middle: the rarer a look, the fewer impostors."""
        return np.asarray(np.einsum("ij,ij->i", white @ self.precision, white))

    def candidates(
        self, suspect: GaussianModel, count: int, rng: np.random.Generator, *, queries: int, deep: bool
    ) -> Candidates:
        """Suspect Gaussians from every region, each with its nearest look: at most `count` pairs, the least ambiguous
        ones.

        `queries` Gaussians are looked up; `deep` draws them at random instead of taking the rarest: in a large foreign
        scene that holds a small piece of the reference, the rarest-looking Gaussians are the foreign ones.
        """
        pool = sample_rows(len(suspect), 10 * queries, rng)
        features = self._columns(invariant_features(suspect, pool, self.degree))
        white = self._whiten(features)
        rarity = self._rarity(white)
        tree, rows = self.rare_tree, self.rows
        # a margin, lest noise carries a query's partner out of the tree
        rare = np.flatnonzero(rarity >= self.threshold * 1.3) if np.isfinite(self.threshold) else np.arange(len(pool))
        if len(rare) < min(queries // 8, len(pool)):
            tree, rows, rare = self.full_tree, np.arange(len(self.all_points)), np.arange(len(pool))
        priority = rng.random(len(rare)) if deep else rarity[rare]
        query = rare[by_region(suspect.means[pool[rare]], priority, queries)]
        distance, near = tree.nearest(white[query], 2)
        # Lowe's ratio: a partner that is much nearer than the next is probably the right one.
        ratio = (distance[:, 0] + 0.01) / (distance[:, 1] + 0.01)
        order = np.lexsort((distance[:, 0], ratio))
        _, first = np.unique(near[order, 0], return_index=True)  # each reference once: copies must not vote twice
        chosen = order[np.sort(first)][:count]
        mine, theirs = rows[near[chosen, 0]].astype(np.int64), pool[query[chosen]].astype(np.int64)
        x, y = suspect.means[theirs].astype(np.float64), self.reference.means[mine].astype(np.float64)
        return Candidates(mine, theirs, x, y, log_sizes(self.reference, mine) - log_sizes(suspect, theirs))


def by_region(means: npt.NDArray[np.float32], priority: Float64, count: int, parts: int = 4) -> Int64:
    """`count` indices, those of highest priority of each of `parts`^3 regions in turn."""
    if len(means) <= count:
        return np.arange(len(means))
    cell = np.zeros(len(means), np.int64)
    for a in range(3):
        edges = np.quantile(means[:, a], np.arange(1, parts) / parts)
        cell = cell * parts + np.searchsorted(edges, means[:, a])
    order = np.lexsort((-priority, cell))
    sizes = np.bincount(cell, minlength=parts**3)
    rank = np.empty(len(means), np.int64)
    rank[order] = np.arange(len(means)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.lexsort((-priority, rank))[:count]


def sample_rows(m: int, count: int, rng: np.random.Generator) -> Int64:
    """At most `count` of m indices, in rising order."""
    return np.arange(m) if m <= count else np.sort(rng.choice(m, count, replace=False))
