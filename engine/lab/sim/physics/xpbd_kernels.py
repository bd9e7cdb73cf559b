"""XPBD constraints and contacts, projected one after the other in a fixed order (Gauss-Seidel), one pass per substep.

A few thousand constraints cost less than waking threads for every color of a coloring, and a fixed order gives
the same bytes whatever the thread count. The direction of the pass alternates, so that no end of a body is
favored. With one pass per substep the multipliers start from zero (Macklin et al., "Small Steps in Physics
Simulation", SCA 2019): a constraint C of compliance alpha gets, over a substep h,

    d_lambda = -C / (sum_i w_i |grad_i C|^2 + alpha / h^2)      (Macklin, Mueller and Chentanez, "XPBD", MIG 2016)

Damping is a pass of its own over velocities, which can only take energy. XPBD's own damping term (its equation
26) weakens the elastic answer where one pass does not converge, and a dropped body gained energy from it
(measured: 30 % at a damping time of 10 ms).

Contacts are planes and spheres that points must stay out of, and other points. What a point moved *into* an obstacle
within the substep is undone and so taken from its velocity: contacts are inelastic. What it was inside already is
resolved by moving its past along, which gives no velocity: bodies that start overlapped come apart without bursting.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math

import numpy as np

from engine.kernels.jit import inlined, kernel

COLLAPSED = 1e-9  # an edge shorter than this share of its rest length has lost its direction and takes that of rest
FLAT = 1e-9  # determinant, as a share of the cubed trace, below which a body's inertia counts as that of a line


@kernel
def predict(x, x_prev, v, w, gravity, keep, h):
    """Remember where points (P, 3) are and move them freely for h seconds; `keep` is what drag leaves of v."""
    for i in range(len(x)):
        for k in range(3):
            x_prev[i, k] = x[i, k]
            if w[i] > 0.0:
                v[i, k] = keep * (v[i, k] + h * gravity[k])
                x[i, k] += h * v[i, k]


@kernel
def update_velocities(x, x_prev, v, w, h):
    """v = (x - x_prev) / h; pinned points rest."""
    for i in range(len(x)):
        for k in range(3):
            v[i, k] = (x[i, k] - x_prev[i, k]) / h if w[i] > 0.0 else 0.0


@inlined
def _part(values, i, j, a, b, dx, dy, dz):
    """Row i moves by a along (dx, dy, dz), row j by b against it."""
    values[i, 0] += a * dx
    values[i, 1] += a * dy
    values[i, 2] += a * dz
    values[j, 0] -= b * dx
    values[j, 1] -= b * dy
    values[j, 2] -= b * dz


@kernel
def project_distances(x, w, edges, rest, compliance, h, backward):
    """|x_i - x_j| = L; edges (E, 2), rest points (P, 3), compliance 1/k per edge (E,)."""
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
        push = (target - length) / (weight + compliance[e] / (h * h))
        _part(x, i, j, w[i] * push, w[j] * push, dx, dy, dz)


@kernel(allocates=True)
def project_volumes(x, w, tets, volumes, compliance, h, backward):
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
        weight = 0.0
        for corner in range(4):
            i = tets[t, corner]
            square = 0.0
            for k in range(3):
                square += g[corner, k] * g[corner, k]
            weight += w[i] * square
        if weight <= 0.0:  # collapsed to a line, or pinned: the edges must open it
            continue
        push = (volumes[t] - volume) / (weight + compliance[t] / (h * h))
        for corner in range(4):
            i = tets[t, corner]
            for k in range(3):
                x[i, k] += w[i] * push * g[corner, k]


@kernel
def damp_velocities(x, v, w, edges, damping, h, backward):
    """Take the rate of strain out of every edge, as a dashpot of `damping` (E,) N s/m does in h seconds.

    Each pulls two points along their line by no more than makes them keep their distance: no energy is added,
    and linear and angular momentum stay.
    """
    count = len(edges)
    for step in range(count):
        e = count - 1 - step if backward else step
        i, j = edges[e, 0], edges[e, 1]
        weight = w[i] + w[j]
        if weight <= 0.0 or damping[e] <= 0.0:
            continue
        dx, dy, dz = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
        square = dx * dx + dy * dy + dz * dz
        if square <= 0.0:
            continue
        rate = dx * (v[i, 0] - v[j, 0]) + dy * (v[i, 1] - v[j, 1]) + dz * (v[i, 2] - v[j, 2])
        pull = -rate / square * (1.0 - math.exp(-damping[e] * weight * h)) / weight
        _part(v, i, j, w[i] * pull, w[j] * pull, dx, dy, dz)


@kernel
def measure_spins(x, x_prev, masses, firsts, spins):
    """h times the angular momentum of each body about the origin, sum of m x_prev cross x, into spins (B, 3).

    It is that of positions x with velocities (x - x_prev) / h, exactly. Body b has points firsts[b] to
    firsts[b + 1].
    """
    for b in range(len(firsts) - 1):
        spins[b, 0], spins[b, 1], spins[b, 2] = 0.0, 0.0, 0.0
        for i in range(firsts[b], firsts[b + 1]):
            for k in range(3):
                m, n = (k + 1) % 3, (k + 2) % 3
                spins[b, k] += masses[i] * (x_prev[i, m] * x[i, n] - x_prev[i, n] * x[i, m])


@inlined
def _determinant(p, q, r):
    """Of the matrix with these columns."""
    return p[0] * (q[1] * r[2] - r[1] * q[2]) - q[0] * (p[1] * r[2] - r[1] * p[2]) + r[0] * (p[1] * q[2] - q[1] * p[2])


@inlined
def _column(a, k):
    return a[0, k], a[1, k], a[2, k]


@kernel(allocates=True)
def restore_spins(x, x_prev, masses, firsts, free, spins, lost):
    """Turn each free body as a whole so that it has the angular momentum `spins` again.

    Projections push along lines between points as they are in the middle of the pass, but momentum counts
    lever arms from where the points were: without this a body that vibrates loses or gains spin (measured:
    3 % a second). `lost` (B, 3) is room for what was lost. The turn is linear in its angle, so one solve of
    three equations is exact; the center of mass stays.
    """
    measure_spins(x, x_prev, masses, firsts, lost)
    center, a = np.empty(3), np.empty((3, 3))
    for b in range(len(firsts) - 1):
        if not free[b]:
            continue
        total = 0.0
        center[:] = 0.0
        for i in range(firsts[b], firsts[b + 1]):
            total += masses[i]
            for k in range(3):
                center[k] += masses[i] * x[i, k]
        for k in range(3):
            center[k] /= total
            lost[b, k] = spins[b, k] - lost[b, k]
        # sum of m p cross (theta cross r) = [sum of m (p.r 1 - r p^T)] theta, with p before and r from the center
        a[:] = 0.0
        for i in range(firsts[b], firsts[b + 1]):
            dot = 0.0
            for k in range(3):
                dot += x_prev[i, k] * (x[i, k] - center[k])
            for k in range(3):
                a[k, k] += masses[i] * dot
                for l in range(3):
                    a[k, l] -= masses[i] * (x[i, k] - center[k]) * x_prev[i, l]
        size = abs(a[0, 0]) + abs(a[1, 1]) + abs(a[2, 2])
        p, q, r, x0 = _column(a, 0), _column(a, 1), _column(a, 2), (lost[b, 0], lost[b, 1], lost[b, 2])
        det = _determinant(p, q, r)
        if abs(det) <= FLAT * size * size * size:  # collapsed to a line: no turn can give it all spins
            continue
        t0, t1, t2 = _determinant(x0, q, r) / det, _determinant(p, x0, r) / det, _determinant(p, q, x0) / det  # Cramer
        for i in range(firsts[b], firsts[b + 1]):
            rx, ry, rz = x[i, 0] - center[0], x[i, 1] - center[1], x[i, 2] - center[2]
            x[i, 0] += t1 * rz - t2 * ry
            x[i, 1] += t2 * rx - t0 * rz
            x[i, 2] += t0 * ry - t1 * rx


RELIEF = 0.2  # share of an old overlap between points that is resolved in one substep

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


@inlined
def _touch(x, rest, body, radii, i, j):
    """Whether points are closer than the sum of their radii, and not neighbors at rest in one body."""
    least = radii[i] + radii[j]
    square, at_rest = 0.0, 0.0
    for k in range(3):
        square += (x[i, k] - x[j, k]) ** 2
        at_rest += (rest[i, k] - rest[j, k]) ** 2
    return square < least * least and (body[i] != body[j] or at_rest >= 4.0 * least * least)


@inlined(allocates=True)
def _sorted_cells(x, surface, reach, size):
    """Cell (S, 3) of each surface point, the points ordered by bucket (S,), and the buckets' starts (size + 1,)."""
    count = len(surface)
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
    return cells, order, starts


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
    cells, order, starts = _sorted_cells(x, surface, reach, size)
    pairs = np.empty((max(64, 4 * count), 2), np.int64)
    found = 0
    for s in range(count):
        i = surface[s]
        for cell in range(13, 27):  # its own cell and one of each pair of opposite neighbors
            a, b, c = cells[s, 0] + cell // 9 - 1, cells[s, 1] + cell // 3 % 3 - 1, cells[s, 2] + cell % 3 - 1
            slot = _bucket(a, b, c, size - 1)
            for at in range(starts[slot], starts[slot + 1]):
                other = order[at]
                if cells[other, 0] != a or cells[other, 1] != b or cells[other, 2] != c:
                    continue
                if cell == 13 and other <= s:
                    continue
                j = surface[other]
                if not _touch(x, rest, body, radii, i, j):
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
