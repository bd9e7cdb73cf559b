"""XPBD constraints, projected one after the other in a fixed order (Gauss-Seidel), one pass per substep.

A few thousand constraints cost less than waking threads for every colour of a colouring, and a fixed order gives
the same bytes whatever the thread count. The direction of the pass alternates, so that no end of a body is
favoured. With one pass per substep the multipliers start from zero (Macklin et al., "Small Steps in Physics
Simulation", SCA 2019), and for a constraint C of compliance alpha and damping time tau, over a substep h,

    d_lambda = (-C - gamma * grad C . (x - x_prev)) / ((1 + gamma) * sum_i w_i |grad_i C|^2 + alpha / h^2)

with gamma = tau / h (Macklin, Mueller and Chentanez, "XPBD", MIG 2016, equation 26, for a damping of tau / alpha).
"""

from __future__ import annotations

import math

import numpy as np

from engine.numerics.jit import kernel
from engine.sim.physics.decompositions import rotation_part

_KERNEL_VERSION = 1

COLLAPSED = 1e-9
"""An edge shorter than this share of its rest length has lost its direction and takes that of rest."""


@kernel
def predict(x, x_prev, v, w, gravity, keep, h):  # type: ignore[no-untyped-def]
    """Remember where points (P, 3) are and move them freely for h seconds; `keep` is what drag leaves of v."""
    for i in range(len(x)):
        for k in range(3):
            x_prev[i, k] = x[i, k]
            if w[i] > 0.0:
                v[i, k] = keep * (v[i, k] + h * gravity[k])
                x[i, k] += h * v[i, k]


@kernel
def update_velocities(x, x_prev, v, w, h):  # type: ignore[no-untyped-def]
    """v = (x - x_prev) / h; pinned points rest."""
    for i in range(len(x)):
        for k in range(3):
            v[i, k] = (x[i, k] - x_prev[i, k]) / h if w[i] > 0.0 else 0.0


@kernel
def project_distances(x, x_prev, w, edges, rest, compliance, damping, h, backward):  # type: ignore[no-untyped-def]
    """|x_i - x_j| = L; edges (E, 2), rest points (P, 3), compliance 1/k and damping time per edge (E,)."""
    count = len(edges)
    for step in range(count):
        e = count - 1 - step if backward else step
        i, j = edges[e, 0], edges[e, 1]
        weight = w[i] + w[j]
        if weight <= 0.0:
            continue
        rx, ry, rz = rest[i, 0] - rest[j, 0], rest[i, 1] - rest[j, 1], rest[i, 2] - rest[j, 2]
        dx, dy, dz = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
        target = math.sqrt(rx * rx + ry * ry + rz * rz)
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if length > COLLAPSED * target:
            dx, dy, dz = dx / length, dy / length, dz / length
        else:
            dx, dy, dz = rx / target, ry / target, rz / target
        gamma = damping[e] / h
        change = (
            dx * (x[i, 0] - x_prev[i, 0] - x[j, 0] + x_prev[j, 0])
            + dy * (x[i, 1] - x_prev[i, 1] - x[j, 1] + x_prev[j, 1])
            + dz * (x[i, 2] - x_prev[i, 2] - x[j, 2] + x_prev[j, 2])
        )
        push = (target - length - gamma * change) / ((1.0 + gamma) * weight + compliance[e] / (h * h))
        a, b = w[i] * push, w[j] * push
        x[i, 0] += a * dx
        x[i, 1] += a * dy
        x[i, 2] += a * dz
        x[j, 0] -= b * dx
        x[j, 1] -= b * dy
        x[j, 2] -= b * dz


@kernel
def project_volumes(x, x_prev, w, tets, volumes, compliance, damping, h, backward):  # type: ignore[no-untyped-def]
    """Signed volume of each tetrahedron (T, 4) = its rest volume (T,): an inverted one is pushed back through."""
    count = len(tets)
    g = np.empty((4, 3))
    a, b, c = np.empty(3), np.empty(3), np.empty(3)
    for step in range(count):
        t = count - 1 - step if backward else step
        i0, i1, i2, i3 = tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3]
        for k in range(3):
            a[k], b[k], c[k] = x[i1, k] - x[i0, k], x[i2, k] - x[i0, k], x[i3, k] - x[i0, k]
        volume = 0.0
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            g[1, k] = (b[m] * c[n] - b[n] * c[m]) / 6.0
            g[2, k] = (c[m] * a[n] - c[n] * a[m]) / 6.0
            g[3, k] = (a[m] * b[n] - a[n] * b[m]) / 6.0
            g[0, k] = -g[1, k] - g[2, k] - g[3, k]
            volume += a[k] * g[1, k]
        weight, change = 0.0, 0.0
        for corner in range(4):
            i = tets[t, corner]
            square = 0.0
            for k in range(3):
                square += g[corner, k] * g[corner, k]
                change += g[corner, k] * (x[i, k] - x_prev[i, k])
            weight += w[i] * square
        gamma = damping[t] / h
        stiff = (1.0 + gamma) * weight + compliance[t] / (h * h)
        if weight <= 0.0 or stiff <= 0.0:  # collapsed to a line, or pinned: the edges must open it
            continue
        push = (volumes[t] - volume - gamma * change) / stiff
        for corner in range(4):
            i = tets[t, corner]
            for k in range(3):
                x[i, k] += w[i] * push * g[corner, k]


@kernel
def match_shapes(x, w, masses, rest, members, starts, rates, h):  # type: ignore[no-untyped-def]
    """Draw the points of each cluster to its best rigid placement (Mueller et al., SIGGRAPH 2005).

    Cluster c holds points members[starts[c]:starts[c + 1]]; each point has the energy
    rate^2 m |x - goal|^2 / 2, so that all points of a cluster move by the same share of their way and linear
    and angular momentum stay.
    """
    moment, turn = np.empty((3, 3)), np.empty((3, 3))
    center, rest_center = np.empty(3), np.empty(3)
    for cluster in range(len(starts) - 1):
        pull = rates[cluster] * h
        share = pull * pull / (1.0 + pull * pull)
        total = 0.0
        center[:] = 0.0
        rest_center[:] = 0.0
        for at in range(starts[cluster], starts[cluster + 1]):
            i = members[at]
            total += masses[i]
            for k in range(3):
                center[k] += masses[i] * x[i, k]
                rest_center[k] += masses[i] * rest[i, k]
        for k in range(3):
            center[k] /= total
            rest_center[k] /= total
        moment[:] = 0.0
        for at in range(starts[cluster], starts[cluster + 1]):
            i = members[at]
            for k in range(3):
                for l in range(3):
                    moment[k, l] += masses[i] * (x[i, k] - center[k]) * (rest[i, l] - rest_center[l])
        rotation_part(moment, turn)
        for at in range(starts[cluster], starts[cluster + 1]):
            i = members[at]
            if w[i] <= 0.0:
                continue
            for k in range(3):
                goal = center[k]
                for l in range(3):
                    goal += turn[k, l] * (rest[i, l] - rest_center[l])
                x[i, k] += share * (goal - x[i, k])
