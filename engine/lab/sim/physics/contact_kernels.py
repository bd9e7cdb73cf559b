"""Contacts: planes and spheres that points must stay out of, and points that must stay out of each other's way.

What a point moved *into* an obstacle within the substep is undone and so taken from its velocity: contacts are
inelastic. What it was inside already is resolved by moving its past along, which gives no velocity: bodies that
start overlapped come apart without bursting.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math

import numpy as np

from engine.kernels.jit import inlined, kernel

RELIEF = 0.2
"""Share of an old overlap between points that is resolved in one substep."""

PRIMES = (73856093, 19349663, 83492791)
"""Of the hash of a cell (Teschner et al., "Optimized spatial hashing", VMV 2003)."""


@inlined(allocates=True)
def _slide(x, x_prev, w, i, normal, flow, depth, friction):
    """Coulomb friction on positions: the step along a surface that moves by `flow`, less friction * depth."""
    slip = 0.0
    along = np.empty(3)
    across = 0.0
    for k in range(3):
        along[k] = x[i, k] - x_prev[i, k] - flow[k]
        across += along[k] * normal[k]
    for k in range(3):
        along[k] -= across * normal[k]
        slip += along[k] * along[k]
    slip = math.sqrt(slip)
    if slip <= 0.0:
        return
    share = min(1.0, friction * depth / slip)
    for k in range(3):
        x[i, k] -= share * along[k]


@inlined
def _keep_out(x, x_prev, w, i, normal, flow, before, now, friction):
    """Point i is `now` deep (scene units) in an obstacle and was `before` deep, along a normal pointing out."""
    old = min(max(before, 0.0), now)
    for k in range(3):
        x[i, k] += now * normal[k]
        x_prev[i, k] += old * normal[k]
    _slide(x, x_prev, w, i, normal, flow, now - old, friction)


@inlined
def _direct(line, length):
    """Make a line of that length a unit vector; where it has none, any way out is as good."""
    if length <= 0.0:
        line[0], line[1], line[2] = 0.0, 0.0, 1.0
    else:
        for k in range(3):
            line[k] /= length


@kernel(allocates=True)
def collide_plane(x, x_prev, w, point, normal, flow, friction):
    """Keep points (P, 3) on the side of a plane that its unit normal (3,) shows to.

    `point` (3,) lies on the plane at the end of the substep; the plane moved by `flow` (3,) in it.
    """
    for i in range(len(x)):
        if w[i] <= 0.0:
            continue
        now, before = 0.0, 0.0
        for k in range(3):
            now += (point[k] - x[i, k]) * normal[k]
            before += (point[k] - flow[k] - x_prev[i, k]) * normal[k]
        if now > 0.0:
            _keep_out(x, x_prev, w, i, normal, flow, before, now, friction)


@kernel(allocates=True)
def collide_sphere(x, x_prev, w, center, radius, flow, friction):
    """Keep points out of a sphere, which moved by `flow` (3,) in the substep and ends it at `center` (3,)."""
    normal = np.empty(3)
    for i in range(len(x)):
        if w[i] <= 0.0:
            continue
        square, before = 0.0, 0.0
        for k in range(3):
            normal[k] = x[i, k] - center[k]
            square += normal[k] * normal[k]
            before += (x_prev[i, k] - center[k] + flow[k]) ** 2
        if square >= radius * radius:
            continue
        distance = math.sqrt(square)
        _direct(normal, distance)
        _keep_out(x, x_prev, w, i, normal, flow, radius - math.sqrt(before), radius - distance, friction)


@inlined
def _bucket(a, b, c, mask):
    return ((a * PRIMES[0]) ^ (b * PRIMES[1]) ^ (c * PRIMES[2])) & mask


@kernel(allocates=True)
def find_pairs(x, rest, surface, body, radii, reach):
    """Pairs (M, 2) of points i < j closer than the sum of their radii, in a fixed order.

    A hash of cells of `reach` (the largest sum of two radii) over the points of `surface` (S,). Points of one
    body that are near each other at rest are the elastic's business and left out.
    """
    count = len(surface)
    size = 16
    while size < 2 * count:
        size *= 2
    cells = np.empty((count, 3), np.int64)
    bucket = np.empty(count, np.int64)
    starts = np.zeros(size + 1, np.int64)
    for s in range(count):
        for k in range(3):
            cells[s, k] = np.int64(math.floor(x[surface[s], k] / reach))
        bucket[s] = _bucket(cells[s, 0], cells[s, 1], cells[s, 2], size - 1)
        starts[bucket[s] + 1] += 1
    for slot in range(size):
        starts[slot + 1] += starts[slot]
    fill = starts[:size].copy()
    order = np.empty(count, np.int64)
    for s in range(count):
        order[fill[bucket[s]]] = s
        fill[bucket[s]] += 1
    pairs = np.empty((max(64, 4 * count), 2), np.int64)
    found = 0
    for s in range(count):
        i = surface[s]
        for cell in range(13, 27):  # its own cell and one of each pair of opposite neighbours
            a, b, c = cells[s, 0] + cell // 9 - 1, cells[s, 1] + cell // 3 % 3 - 1, cells[s, 2] + cell % 3 - 1
            slot = _bucket(a, b, c, size - 1)
            for at in range(starts[slot], starts[slot + 1]):
                other = order[at]
                if cells[other, 0] != a or cells[other, 1] != b or cells[other, 2] != c:
                    continue
                if cell == 13 and other <= s:
                    continue
                j = surface[other]
                least = radii[i] + radii[j]
                square, at_rest = 0.0, 0.0
                for k in range(3):
                    square += (x[i, k] - x[j, k]) ** 2
                    at_rest += (rest[i, k] - rest[j, k]) ** 2
                if square >= least * least or (body[i] == body[j] and at_rest < 4.0 * least * least):
                    continue
                if found == len(pairs):
                    larger = np.empty((2 * found, 2), np.int64)
                    larger[:found] = pairs
                    pairs = larger
                pairs[found, 0], pairs[found, 1] = min(i, j), max(i, j)
                found += 1
    return pairs[:found]


@kernel(allocates=True)
def collide_pairs(x, x_prev, w, pairs, radii):
    """Move the points of each pair apart, all pairs at once (Jacobi).

    They are pushed along the line between them at the start of the substep, from where momentum counts its
    lever arms, and both use the same divisor, the larger of their numbers of pairs: so linear and angular
    momentum stay.
    """
    crowd = np.zeros(len(x), np.int64)
    for p in range(len(pairs)):
        crowd[pairs[p, 0]] += 1
        crowd[pairs[p, 1]] += 1
    shift = np.zeros((len(x), 3))
    past = np.zeros((len(x), 3))
    line = np.empty(3)
    for p in range(len(pairs)):
        i, j = pairs[p, 0], pairs[p, 1]
        weight = (w[i] + w[j]) * max(crowd[i], crowd[j])
        if weight <= 0.0:
            continue
        least = radii[i] + radii[j]
        square = 0.0
        for k in range(3):
            line[k] = x_prev[i, k] - x_prev[j, k]
            square += line[k] * line[k]
        before = math.sqrt(square)
        _direct(line, before)
        apart = 0.0
        for k in range(3):
            apart += line[k] * (x[i, k] - x[j, k])
        old = max(least - before, 0.0)
        silent = RELIEF * old / weight
        push = max(least - old - apart, 0.0) / weight + silent
        for k in range(3):
            shift[i, k] += w[i] * push * line[k]
            shift[j, k] -= w[j] * push * line[k]
            past[i, k] += w[i] * silent * line[k]
            past[j, k] -= w[j] * silent * line[k]
    for i in range(len(x)):
        if crowd[i] > 0:
            for k in range(3):
                x[i, k] += shift[i, k]
                x_prev[i, k] += past[i, k]
