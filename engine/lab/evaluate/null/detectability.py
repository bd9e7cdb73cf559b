"""Do the numbers in a marked file look different? Sinkhorn divergences of attribute distributions (KeySS, ICLR 2026).

The searcher has no key and no original; the strictest case gives him unmarked Gaussians of the very same scene.
"""

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import logsumexp

from engine.lab.evaluate.marked_subjects import fast_mark
from engine.lab.evaluate.study import Row
from engine.model import Float64, GaussianModel

__all__ = ["compare_attributes", "divergence", "permutation_test", "squared_distances", "transport_cost"]


def compare_attributes(path: str, samples: int, draws: int, keys: int, quick: bool, seed: int) -> list[Row]:
    """Disjoint random samples of one scene: unmarked against unmarked, unmarked against marked, one row for each.

    A blatant mark (DC 20 times as far displaced) is the control: the test can detect one.
    """
    rows = []
    for number in range(keys):
        scene = fast_mark(path, quick, seed + number)
        order = np.random.default_rng((seed, number, 0x51)).permutation(len(scene.marked))
        here, there = order[:samples], order[samples : 2 * samples]
        reference = scene.opened.reference.sh
        blatant = scene.marked.with_(sh=reference + np.float32(20.0) * (scene.marked.sh - reference))
        others = {
            "another unmarked sample": scene.original,
            "marked": scene.marked,
            "marked 20 times as strongly": blatant,
        }
        for features, table in (("colour", _colors), ("all attributes", _attributes)):
            scale = table(scene.original).std(axis=0) + 1e-9
            plain = table(scene.original)[here] / scale
            about = {"what": "detectability", "scene": scene.name, "key": seed + number, "features": features}
            for name, model in others.items():
                distance, p, null = permutation_test(plain, table(model)[there] / scale, draws=draws, seed=seed)
                chance = {"draws": draws, "null_median": float(np.median(null)), "null_highest": max(null)}
                rows.append({**about, "against": name, "samples": samples, "distance": distance, "p": p, **chance})
    return rows


def _colors(model: GaussianModel) -> Float64:
    return model.sh[:, 0].astype(np.float64)


def _attributes(model: GaussianModel) -> Float64:
    columns = [model.sh[:, 0], np.sort(model.log_scales, axis=1), model.opacity_logits[:, None]]
    return np.concatenate(columns, axis=1).astype(np.float64)


def squared_distances(a: Float64, b: Float64) -> Float64:
    """(n, m) squared Euclidean distances of the rows of (n, d) and (m, d)."""
    return np.asarray(cdist(a, b, "sqeuclidean"))


def transport_cost(cost: Float64, epsilon: float, *, tolerance: float = 1e-6, rounds: int = 500) -> float:
    """Entropic optimal transport between two uniform samples: the value of the dual, sum of the mean potentials.

    Iterated on the dual, in logarithms where needed (Cuturi, "Sinkhorn distances", NIPS 2013; symmetrised steps as in
    Feydy et al., AISTATS 2019), until no potential changes by more than `tolerance` times epsilon.

    Parameters
    ----------
    cost : (n, m) float64
    epsilon : float
        Weight of the entropy (relative to the product measure), in the unit of the cost, > 0.
    """
    kernel = np.exp(-cost / epsilon)
    n, m = cost.shape
    f, g = np.zeros(n), np.zeros(m)
    for _ in range(rounds):
        with np.errstate(all="ignore"):  # what over- or underflows is done again with logarithms
            new_f = -epsilon * np.log(kernel @ np.exp(g / epsilon) / m)
            new_g = -epsilon * np.log(np.exp(new_f / epsilon) @ kernel / n)
        if not (np.isfinite(new_f).all() and np.isfinite(new_g).all()):
            new_f = -epsilon * (logsumexp((g[None] - cost) / epsilon, axis=1) - np.log(m))
            new_g = -epsilon * (logsumexp((new_f[:, None] - cost) / epsilon, axis=0) - np.log(n))
        change = max(float(np.abs(new_f - f).max()), float(np.abs(new_g - g).max()))
        f, g = new_f, new_g
        if change <= tolerance * epsilon:
            break
    return float(f.mean() + g.mean())


def divergence(cost: Float64, first: int, epsilon: float) -> float:
    """Sinkhorn divergence of the `first` rows of a joint sample against the others: 0 for equal samples.

    `cost`, (n + m, n + m), is of all pairs of both samples.
    """
    across = transport_cost(cost[:first, first:], epsilon, tolerance=1e-3)
    within = transport_cost(cost[:first, :first], epsilon, tolerance=1e-3)
    within += transport_cost(cost[first:, first:], epsilon, tolerance=1e-3)
    return across - 0.5 * within


def permutation_test(
    a: Float64, b: Float64, *, draws: int, epsilon_share: float = 0.1, seed: int = 0
) -> tuple[float, float, list[float]]:
    """Whether two samples, (n, d) and (m, d), look drawn from one distribution: their divergence, p, and the null.

    The null are divergences of as many random divisions of the joint sample as there are `draws`; p is the share of
    divisions, this one counted, at least as far apart: exact. The entropy weighs `epsilon_share` of the median cost.
    """
    joint = np.concatenate([a, b])
    cost = squared_distances(joint, joint)
    epsilon = epsilon_share * float(np.median(cost))
    distance = divergence(cost, len(a), epsilon)
    rng = np.random.default_rng(seed)
    null = []
    for _ in range(draws):
        order = rng.permutation(len(joint))
        null.append(divergence(cost[np.ix_(order, order)], len(a), epsilon))
    return distance, (1 + sum(value >= distance for value in null)) / (1 + draws), null
