"""Similarities between two models, proposed by pairs of candidates that agree with each other.

A candidate is one suspect and one reference Gaussian that look alike; most are wrong. Two right ones agree:
both show the same change of size, the distance between them changed by that same factor, and (where rotations
are to be trusted) both turned alike, carrying the line from one to the other along. Two wrong ones hardly
ever do all that. So agreement is counted over all pairs, and triples are drawn only where it is dense.
"""

import math
from dataclasses import dataclass

import numpy as np

from engine.model import Float64, Int64
from engine.numerics.umeyama import Similarity, robust_umeyama
from engine.registration.config import Agreement
from engine.registration.match_candidates import Candidates
from engine.registration.match_kernels import BINS, Pairs, best_triples, degrees_of_agreement, evidence


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A similarity and what speaks for it.

    `evidence`: log likelihood ratio, in nats, of the residuals against chance pairs, at the best tolerance, less what
    the same similarity gets for shuffled pairs. `inliers` (k,): candidates within that tolerance.
    """

    fit: Similarity
    evidence: float
    inliers: Int64


def chance_table(means: Float64, extent: float, rng: np.random.Generator, samples: int = 200_000) -> Float64:
    """(BINS,) chance that two random reference Gaussians lie within each tolerance, from so many samples."""
    a, b = means[rng.integers(len(means), size=(2, samples))]
    e2 = np.square(a - b).sum(1) / extent**2
    bins = np.clip(np.floor(-np.log2(np.maximum(e2, 2.0**-BINS))), -1, BINS - 1).astype(int)
    counts = np.bincount(bins + 1, minlength=BINS + 1)[1:]
    share = np.cumsum(counts[::-1])[::-1] / len(a)
    # Below the reach of the sample the chance falls with the volume; 8 per bin pair is 2^1.5 per bin.
    for b_ in range(1, BINS):
        share[b_] = max(share[b_], share[b_ - 1] * 2.0**-1.5, 1e-7)
    return np.maximum(share, 1e-7)


def propose(
    candidates: Candidates,
    turn: Float64,
    agreement: Agreement,
    extent: float,
    chance: Float64,
    *,
    seeds: int,
    draws: int,
    seed: int,
) -> tuple[list[Hypothesis], int]:
    """Hypotheses from candidates, best first, and how many triples were scored.

    `turn` (n, 4): rotation of each pair as unit quaternion, reference after suspect. `extent`: size of the reference,
    scene units. `chance` (BINS,): from `chance_table`. `draws` triples are drawn around each of `seeds` candidates.
    """
    if len(candidates) < 4:
        return [], 0
    pairs = Pairs(candidates.x, candidates.y, candidates.size, turn)
    degrees = degrees_of_agreement(pairs, agreement)
    chosen = np.argsort(-degrees, kind="stable")[:seeds].astype(np.int64)
    tol_size = 2.0 * agreement.size
    triples = best_triples(pairs, agreement, extent, chance, seeds=chosen, draws=draws, seed=seed)
    shuffles = [np.random.default_rng([seed, i]).permutation(len(pairs)) for i in range(3)]
    found: list[Hypothesis] = []
    for s in np.argsort(-triples.scores, kind="stable")[:8]:
        if triples.scores[s] <= 0:
            break
        fit = Similarity(float(triples.moves[s, 0]), triples.turns[s], triples.moves[s, 1:].copy())
        score, at = float(triples.scores[s]), int(triples.bins[s])
        inliers = _inliers(pairs, fit, tol_size, extent, at)
        for _ in range(3):
            better = robust_umeyama(pairs.x[inliers], pairs.y[inliers], rounds=5)
            if better is None:
                break
            moved = np.concatenate([[better.scale], better.t])  # (4,)
            new, new_at = evidence(pairs, better.R, moved, tol_size, extent, chance)
            if new <= score:
                break
            fit, score, at = better, float(new), int(new_at)
            inliers = _inliers(pairs, fit, tol_size, extent, at)
        if any(np.isin(inliers, other.inliers).mean() > 0.5 for other in found):
            continue  # found before
        # Two crowds laid upon each other explain much by accident, and shuffled pairs just as well.
        moved = np.concatenate([[fit.scale], fit.t])  # (4,)
        accident = max(evidence(pairs.shuffled(p), fit.R, moved, tol_size, extent, chance)[0] for p in shuffles)
        found.append(Hypothesis(fit, score - accident, inliers))
    found.sort(key=lambda h: -h.evidence)
    return found, int(triples.tries.sum())


def _inliers(pairs: Pairs, fit: Similarity, tol_size: float, extent: float, at: int) -> Int64:
    """Candidates that a similarity explains in size and, within tolerance number `at`, in position."""
    error2 = np.square(fit.apply(pairs.x) - pairs.y).sum(1)
    near = np.abs(pairs.size - math.log(fit.scale)) <= tol_size
    return np.flatnonzero(near & (error2 <= extent**2 * 2.0 ** -float(at)))
