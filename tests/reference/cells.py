"""Slow twin of engine.compress.cells: recursive split at the weighted median of the widest feature."""

from __future__ import annotations

import numpy as np


def split_cells(features: np.ndarray, weights: np.ndarray, count: int) -> np.ndarray:
    n = len(features)
    depth = int(np.log2(max(1, min(count, n))))
    weights = weights + 0.02 * weights.mean() + 1e-12
    cells = [np.arange(n)]
    for _ in range(depth):
        halves: list[np.ndarray] = []
        for members in cells:
            halves += _halve(members, features, weights)
        cells = halves
    labels = np.empty(n, dtype=np.int32)
    for number, members in enumerate(cells):
        labels[members] = number
    return labels


def _halve(members: np.ndarray, features: np.ndarray, weights: np.ndarray) -> list[np.ndarray]:
    if len(members) < 2:
        return [members]
    w = weights[members]
    mean = (w[:, None] * features[members]).sum(axis=0) / w.sum()
    widest = int(np.argmax((w[:, None] * (features[members] - mean) ** 2).sum(axis=0)))
    members = members[np.argsort(features[members, widest], kind="stable")]
    running = np.cumsum(weights[members])
    cut = int((running < 0.5 * w.sum()).sum()) + 1
    cut = min(max(cut, 1), len(members) - 1)
    return [np.sort(members[:cut]), np.sort(members[cut:])]
