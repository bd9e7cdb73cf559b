"""Slow twin of engine.compress.levels_of_detail and engine.numerics.gaussians: what one pair costs, which are
taken, what a group becomes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from engine.model import GaussianModel
from tests.reference.raster import rotations


def covariance(model: GaussianModel, i: int) -> np.ndarray:
    """(3, 3) R S S^T R^T."""
    half = rotations(torch.as_tensor(model.quats[i : i + 1].astype(float)))[0].numpy() @ np.diag(
        np.exp(model.log_scales[i].astype(float))
    )
    return half @ half.T


def moments(
    masses: Sequence[float], means: Sequence[np.ndarray], covariances: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (3,) and covariance (3, 3) of a mixture."""
    shares = np.array(masses) / np.sum(masses)
    mean = sum(s * m for s, m in zip(shares, means, strict=True))
    spread = sum(s * (c + np.outer(m - mean, m - mean)) for s, m, c in zip(shares, means, covariances, strict=True))
    return np.asarray(mean), np.asarray(spread)


def pair_cost(
    masses: Sequence[float],
    means: Sequence[np.ndarray],
    covariances: Sequence[np.ndarray],
    looks: Sequence[np.ndarray],
    color_std: float,
) -> float:
    """Half the log determinant that a pair gains by becoming one, and half the squared distance of the looks."""
    shares = np.array(masses) / np.sum(masses)
    _, joint = moments(masses, means, covariances)
    dets = [np.log(np.linalg.det(c)) for c in covariances]
    apart = np.square((looks[0] - looks[1]) / color_std).sum()
    return float(0.5 * (np.log(np.linalg.det(joint)) - shares @ dets) + 0.5 * apart)


def greedy_pairs(edges: Sequence[tuple[int, int]], wanted: int) -> list[tuple[int, int]]:
    """The first `wanted` edges of which none shares an end with one before it."""
    chosen: list[tuple[int, int]] = []
    for edge in edges:
        if len(chosen) < wanted and not any(set(edge) & set(other) for other in chosen):
            chosen.append(edge)
    return chosen
