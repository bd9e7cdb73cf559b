"""Slow, obviously right quantisers: the best scalar codebook, and plain k-means."""

from __future__ import annotations

import numpy as np


def best_codebook_error(values: np.ndarray, levels: int) -> float:
    """Least possible sum of squared errors of so many values for all: dynamic programming, O(levels n^2)."""
    x = np.sort(values.astype(float).ravel())
    n = len(x)
    s1, s2 = np.concatenate([[0], np.cumsum(x)]), np.concatenate([[0], np.cumsum(x * x)])
    start, end = np.arange(n)[:, None], np.arange(1, n + 1)[None, :]  # cost of x[start:end] as one cell
    with np.errstate(divide="ignore", invalid="ignore"):
        cost = s2[end] - s2[start] - (s1[end] - s1[start]) ** 2 / (end - start)
    cost = np.where(end > start, np.maximum(cost, 0.0), np.inf)
    best = cost[0]
    for _ in range(levels - 1):
        best = np.minimum(best, np.min(best[:-1, None] + cost[1:], axis=0))
    return float(best[-1])


def kmeans_error(vectors: np.ndarray, count: int, rounds: int, seed: int) -> float:
    """Mean squared distance after plain k-means that compares everything with everything."""
    rng = np.random.default_rng(seed)
    centres = vectors[rng.choice(len(vectors), count, replace=False)].astype(float)
    for _ in range(rounds):
        distance = ((vectors[:, None] - centres) ** 2).sum(axis=2)
        labels = distance.argmin(axis=1)
        for j in np.unique(labels):
            centres[j] = vectors[labels == j].mean(axis=0)
    return float(((vectors[:, None] - centres) ** 2).sum(axis=2).min(axis=1).mean())
