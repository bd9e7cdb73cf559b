"""Votes that agree, one pair and one vote at a time: what `engine.pictures.camera.voted_views` does in a kernel."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from engine.model import Float64, Int64
from engine.pictures.camera.voted_views import APART, LARGEST, MOST, SMALLEST, TOLERANCE


def agreement_slowly(view: Int64, spots: Float64, places: Float64, gain: Float64) -> tuple[Int64, Float64]:
    """As `agreement_of_views`."""
    names = np.unique(view)
    return names, np.array([_best(*(part[view == name] for part in (spots, places, gain))) for name in names])


def _best(spots: Float64, places: Float64, gain: Float64) -> float:
    loudest = np.argsort(-gain, kind="stable")[:MOST]
    z, w, gain = spots[loudest] @ (1, 1j), places[loudest] @ (1, 1j), gain[loudest]
    best = 0.0
    for i, j in combinations(range(len(z)), 2):
        dz, dw = abs(z[j] - z[i]), abs(w[j] - w[i])
        if min(dz, dw) < APART or not SMALLEST * dz <= dw <= LARGEST * dz:
            continue
        carried = (w[j] - w[i]) / (z[j] - z[i]) * (z - z[i]) + w[i]
        used: set[tuple[str, float, float]] = set()
        total = 0.0
        for k in np.flatnonzero(np.abs(carried - w) <= TOLERANCE * min(1.0, dw / dz) ** 0.5):
            who = {(kind, p.real // 3, p.imag // 3) for kind, p in (("spot", z[k]), ("place", w[k]))}
            if not used & who:
                used |= who
                total += gain[k]
        best = max(best, total)
    return best
