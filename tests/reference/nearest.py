"""Slow twin of engine.numerics.nearest: every query against every reference point."""

from __future__ import annotations

import numpy as np


def distances2(
    refs: np.ndarray,
    ref_quats: np.ndarray,
    point: np.ndarray,
    quat: np.ndarray,
    *,
    quat_weight: float,
    hard: int,
    soft_cap: float,
) -> np.ndarray:
    """(N,) squared distances of one query."""
    e2 = (refs.astype(float) - point.astype(float)) ** 2
    half_cosine = np.abs(ref_quats.astype(float) @ quat.astype(float))
    turn2 = 8 * np.clip(1 - half_cosine, 0, None) * quat_weight
    return e2[:, :hard].sum(1) + np.minimum(e2[:, hard:].sum(1), soft_cap) + turn2
