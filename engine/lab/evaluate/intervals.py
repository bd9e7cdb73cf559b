"""Intervals around what was measured: shares of trials, anything with repeats, and how well scores tell two kinds."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import beta, mannwhitneyu

from engine.model import Float64

__all__ = ["area", "area_interval", "bootstrap", "share_interval"]

CONFIDENCE = 0.95
TAILS = ((1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0)


def share_interval(hits: int, trials: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Exact interval of a probability from `hits` of `trials` (Clopper and Pearson, 1934).

    Its coverage is never below `confidence`; 0 of n gives (0, 1 - (alpha / 2)^(1 / n)).
    """
    if not 0 <= hits <= trials:
        raise ValueError(f"{hits} hits of {trials} trials")
    tail = (1.0 - confidence) / 2.0
    low = float(beta.ppf(tail, hits, trials - hits + 1)) if hits else 0.0
    high = float(beta.ppf(1.0 - tail, hits + 1, trials - hits)) if hits < trials else 1.0
    return low, high


def bootstrap(values: Sequence[float], *, draws: int = 2_000, seed: int = 0) -> tuple[float, float]:
    """95 % percentile interval of the mean under resampling.

    With one value, that value twice: nothing is known about its spread, and the caller should say so.
    """
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or len(sample) == 0:
        raise ValueError(f"a mean needs a list of values, got shape {sample.shape}")
    drawn = sample[np.random.default_rng(seed).integers(len(sample), size=(draws, len(sample)))]
    low, high = np.quantile(drawn.mean(axis=1), TAILS)
    return float(low), float(high)


def area(negative: Float64, positive: Float64) -> float:
    """Area below the ROC: probability that a positive scores above a negative, ties counted half."""
    above = mannwhitneyu(positive, negative, method="asymptotic").statistic
    return float(above / (len(positive) * len(negative)))


def area_interval(places: Sequence[tuple[Float64, Float64]], *, draws: int = 500, seed: int = 0) -> tuple[float, float]:
    """95 % interval of `area` by resampling what was seen once.

    `places` are views or regions, each with its negative and positive scores, drawn together: they are alike.
    """
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(draws):
        chosen = [places[k] for k in rng.integers(len(places), size=len(places))]
        found.append(area(np.concatenate([a for a, _ in chosen]), np.concatenate([b for _, b in chosen])))
    low, high = np.quantile(found, TAILS)
    return float(low), float(high)
