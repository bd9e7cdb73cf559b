"""Intervals around what was measured: shares of trials, and anything with repeats."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import beta

__all__ = ["bootstrap", "share_interval"]

CONFIDENCE = 0.95


def share_interval(hits: int, trials: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Exact interval of a probability from `hits` of `trials` (Clopper and Pearson, 1934).

    Its coverage is never below `confidence`; 0 of n gives (0, 1 - (alpha / 2)^(1 / n)).
    """
    if not 0 <= hits <= trials:
        raise ValueError(f"{hits} hits of {trials} trials")
    if trials == 0:
        return 0.0, 1.0
    tail = (1.0 - confidence) / 2.0
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, trials - hits + 1))
    high = 1.0 if hits == trials else float(beta.ppf(1.0 - tail, hits + 1, trials - hits))
    return low, high


def bootstrap(
    values: Sequence[float],
    statistic: Callable[[np.ndarray], np.ndarray] | None = None,
    *,
    draws: int = 2_000,
    seed: int = 0,
    confidence: float = CONFIDENCE,
) -> tuple[float, float]:
    """Percentile interval of a statistic (along axis 1 of a (draws, n) array; default: the mean) under resampling.

    With one value, that value twice: nothing is known about its spread, and the caller should say so.
    """
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or len(sample) == 0:
        raise ValueError(f"a statistic needs a list of values, got shape {sample.shape}")
    statistic = statistic or (lambda drawn: drawn.mean(axis=1))
    drawn = sample[np.random.default_rng(seed).integers(len(sample), size=(draws, len(sample)))]
    low, high = np.quantile(statistic(drawn), [(1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0])
    return float(low), float(high)
