"""Slow, obviously right twins of engine.lab.sim.physics' kernels: one constraint at a time, by the formulas."""

from __future__ import annotations

import numpy as np


def project(
    x: np.ndarray, w: np.ndarray, who: np.ndarray, violation: float, gradient: np.ndarray, compliance: float, h: float
) -> None:
    """XPBD for one constraint on points `who` with gradient (len(who), 3), multiplier from zero."""
    weight = (w[who] * (gradient**2).sum(axis=1)).sum()
    if weight == 0:
        return
    d_lambda = -violation / (weight + compliance / h**2)
    x[who] += w[who, None] * d_lambda * gradient


def distances(x, w, edges, rest, compliance, h, backward):  # type: ignore[no-untyped-def]
    for e in range(len(edges))[:: -1 if backward else 1]:
        i, j = edges[e]
        line, rest_line = x[i] - x[j], rest[i] - rest[j]
        length, target = np.linalg.norm(line), np.linalg.norm(rest_line)
        n = line / length if length > 1e-9 * target else rest_line / target
        project(x, w, edges[e], length - target, np.stack([n, -n]), compliance[e], h)


def volumes(x, w, tets, targets, compliance, h, backward):  # type: ignore[no-untyped-def]
    for t in range(len(tets))[:: -1 if backward else 1]:
        p = x[tets[t]]
        volume = np.dot(np.cross(p[1] - p[0], p[2] - p[0]), p[3] - p[0]) / 6
        g1 = np.cross(p[2] - p[0], p[3] - p[0]) / 6
        g2 = np.cross(p[3] - p[0], p[1] - p[0]) / 6
        g3 = np.cross(p[1] - p[0], p[2] - p[0]) / 6
        gradient = np.stack([-g1 - g2 - g3, g1, g2, g3])
        project(x, w, tets[t], volume - targets[t], gradient, compliance[t], h)


def dashpots(x, v, w, edges, damping, h, backward):  # type: ignore[no-untyped-def]
    """Relative speed along the edge decays as that of two masses with a dashpot between them."""
    for e in range(len(edges))[:: -1 if backward else 1]:
        i, j = edges[e]
        if w[i] + w[j] == 0:
            continue
        n = (x[i] - x[j]) / np.linalg.norm(x[i] - x[j])
        speed = n @ (v[i] - v[j])
        slower = speed * np.exp(-damping[e] * (w[i] + w[j]) * h)
        impulse = (slower - speed) / (w[i] + w[j])
        v[i] += w[i] * impulse * n
        v[j] -= w[j] * impulse * n


def pairs(x, rest, surface, body, radii):  # type: ignore[no-untyped-def]
    """Every pair i < j in contact, by trying them all."""
    found = set()
    for a, i in enumerate(surface):
        for j in surface[a + 1 :]:
            least = radii[i] + radii[j]
            near_at_rest = body[i] == body[j] and np.linalg.norm(rest[i] - rest[j]) < 2 * least
            if np.linalg.norm(x[i] - x[j]) < least and not near_at_rest:
                found.add((min(i, j), max(i, j)))
    return found


def barycentric(point: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Weights (4,) of a point by solving for them."""
    return np.linalg.solve(np.vstack([corners.T, np.ones(4)]), np.append(point, 1.0))
