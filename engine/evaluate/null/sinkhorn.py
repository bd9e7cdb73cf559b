"""Sinkhorn divergence of two samples: how far apart two distributions lie, and whether chance explains it."""

import numpy as np

from engine.model import Float64

__all__ = ["divergence", "permutation_test", "squared_distances", "transport_cost"]


def squared_distances(a: Float64, b: Float64) -> Float64:
    """(n, m) squared Euclidean distances of the rows of (n, d) and (m, d)."""
    squares = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1)[None] - 2.0 * a @ b.T
    return np.asarray(np.maximum(squares, 0.0))


def transport_cost(cost: Float64, epsilon: float, *, tolerance: float = 1e-6, rounds: int = 500) -> float:
    """Entropic optimal transport between two uniform samples, iterated on the dual; in logarithms where needed.

    Parameters
    ----------
    cost : (n, m) float64
    epsilon : float
        Weight of the entropy (relative to the product measure), in the unit of the cost, > 0.
    tolerance : float
        Largest change of a dual potential, relative to epsilon, that ends the iteration.
    rounds : int
        At most.

    Returns
    -------
    float
        Value of the dual: sum of the mean potentials.

    Notes
    -----
    Cuturi, "Sinkhorn distances", NIPS 2013; symmetrised steps as in Feydy et al., AISTATS 2019.
    """
    kernel = np.exp(-cost / epsilon)
    n, m = cost.shape
    f, g = np.zeros(n), np.zeros(m)
    for _ in range(rounds):
        with np.errstate(all="ignore"):  # what over- or underflows is done again with logarithms
            new_f = -epsilon * np.log(kernel @ np.exp(g / epsilon) / m)
            new_g = -epsilon * np.log(np.exp(new_f / epsilon) @ kernel / n)
        if not (np.isfinite(new_f).all() and np.isfinite(new_g).all()):
            new_f = -epsilon * (_log_sum_exp((g[None] - cost) / epsilon) - np.log(m))
            new_g = -epsilon * (_log_sum_exp((new_f[:, None] - cost).T / epsilon) - np.log(n))
        change = max(float(np.abs(new_f - f).max()), float(np.abs(new_g - g).max()))
        f, g = new_f, new_g
        if change <= tolerance * epsilon:
            break
    return float(f.mean() + g.mean())


def _log_sum_exp(values: Float64) -> Float64:
    """(n,) over the second axis."""
    top = values.max(axis=1)
    return np.asarray(top + np.log(np.exp(values - top[:, None]).sum(axis=1)))


def divergence(cost: Float64, first: int, epsilon: float) -> float:
    """Sinkhorn divergence of the first rows of a joint sample against the others: 0 for equal samples.

    Parameters
    ----------
    cost : (n + m, n + m) float64
        Of all pairs of both samples.
    first : int
        n.
    """
    across = transport_cost(cost[:first, first:], epsilon, tolerance=1e-3)
    within = transport_cost(cost[:first, :first], epsilon, tolerance=1e-3)
    within += transport_cost(cost[first:, first:], epsilon, tolerance=1e-3)
    return across - 0.5 * within


def permutation_test(
    a: Float64, b: Float64, *, draws: int, epsilon_share: float = 0.1, seed: int = 0
) -> tuple[float, float, list[float]]:
    """Whether two samples look drawn from one distribution.

    Parameters
    ----------
    a, b : (n, d), (m, d)
    draws : int
        Random divisions of the joint sample.
    epsilon_share : float
        Entropy's weight, of the median cost.

    Returns
    -------
    distance : float
        Sinkhorn divergence of the samples.
    p : float
        Share of divisions, this one counted, at least as far apart: exact under the null.
    null : list of float
        Divergences of the random divisions.
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
