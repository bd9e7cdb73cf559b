"""ROC curves and the area below them, with intervals that respect what belongs together."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import rankdata

from engine.model import Float64

__all__ = ["area", "area_interval", "rates"]


def area(negative: Float64, positive: Float64) -> float:
    """Probability that a positive scores above a negative, ties counted half (Mann and Whitney).

    Parameters
    ----------
    negative, positive : (n,), (m,)
        Scores.
    """
    ranks = rankdata(np.concatenate([negative, positive]))
    m, n = len(positive), len(negative)
    return float((ranks[n:].sum() - 0.5 * m * (m + 1)) / (m * n))


def area_interval(
    negative: Float64,
    positive: Float64,
    groups: Sequence[tuple[Float64, Float64]] | None = None,
    *,
    draws: int = 500,
    seed: int = 0,
) -> tuple[float, float]:
    """95 % interval of `area` by resampling what was seen once.

    Parameters
    ----------
    negative, positive : (n,), (n,)
        Of the same n views or regions, drawn together: the scores of one place are alike.
    groups : sequence of (negative, positive), optional
        Several scores of one place each; then the first two arguments are not looked at.

    Returns
    -------
    low, high : float
    """
    places = groups or [(negative[k : k + 1], positive[k : k + 1]) for k in range(len(negative))]
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(draws):
        chosen = [places[k] for k in rng.integers(len(places), size=len(places))]
        found.append(area(np.concatenate([a for a, _ in chosen]), np.concatenate([b for _, b in chosen])))
    low, high = np.quantile(found, [0.025, 0.975])
    return float(low), float(high)


def rates(negative: Float64, positive: Float64, thresholds: Sequence[float]) -> list[tuple[float, float, float]]:
    """(threshold, false alarms, hits) with everything at or above a threshold called positive."""
    return [(t, float((negative >= t).mean()), float((positive >= t).mean())) for t in thresholds]
