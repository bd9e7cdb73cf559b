"""Decompositions of 3x3 matrices inside numba kernels, by one-sided Jacobi rotations.

Hestenes' method turns pairs of columns until all are orthogonal: A V = U S. It never squares the matrix, so
thin axes keep their relative accuracy (Demmel and Veselic, SIAM J. Matrix Anal. 1992), it never reorders
columns, so a matrix whose columns are orthogonal already comes back as it was, and nothing in it can fail:
zero columns stay zero.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math

import numpy as np

from engine.kernels.jit import inlined

SWEEPS = 12  # sweeps over the three pairs of columns; convergence is quadratic, 4 to 6 do
ORTHOGONAL = 1e-15  # cosine between two columns that counts as none
VANISHING = 1e-14  # length of a column, as a share of the largest, that is rounding alone: it has no direction


@inlined
def orthogonalize(a, v):
    """Turn the columns of a (3, 3) until they are orthogonal, in place; v (3, 3) is turned along."""
    for _ in range(SWEEPS):
        turned = False
        for pair in range(3):
            p = 0 if pair < 2 else 1
            q = 1 if pair == 0 else 2
            pp = a[0, p] * a[0, p] + a[1, p] * a[1, p] + a[2, p] * a[2, p]
            qq = a[0, q] * a[0, q] + a[1, q] * a[1, q] + a[2, q] * a[2, q]
            pq = a[0, p] * a[0, q] + a[1, p] * a[1, q] + a[2, p] * a[2, q]
            if abs(pq) <= ORTHOGONAL * math.sqrt(pp) * math.sqrt(qq):
                continue
            turned = True
            zeta = (qq - pp) / (2.0 * pq)
            t = 1.0 / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
            if zeta < 0.0:
                t = -t
            c = 1.0 / math.sqrt(1.0 + t * t)
            s = c * t
            for k in range(3):
                x, y = a[k, p], a[k, q]
                a[k, p], a[k, q] = c * x - s * y, s * x + c * y
                x, y = v[k, p], v[k, q]
                v[k, p], v[k, q] = c * x - s * y, s * x + c * y
        if not turned:
            break


@inlined
def _fill_large(a, r, large, size):
    """Column `large` of r: that of a at length 1, or a coordinate axis where it vanishes."""
    for k in range(3):
        if size > 0.0:
            r[k, large] = a[k, large] / size
        else:
            r[k, large] = 1.0 if k == large else 0.0


@inlined
def _fill_middle(a, r, large, middle, size, vanishes):
    """Column `middle` of r, perpendicular to `large` and of length 1."""
    if not vanishes:
        along = 0.0
        for k in range(3):
            r[k, middle] = a[k, middle] / size
            along += r[k, middle] * r[k, large]
        for k in range(3):
            r[k, middle] -= along * r[k, large]
    else:  # any direction across the large column: the coordinate axis that is least along it
        axis = 0
        for k in range(1, 3):
            if abs(r[k, large]) < abs(r[axis, large]):
                axis = k
        for k in range(3):
            r[k, middle] = (1.0 if k == axis else 0.0) - r[axis, large] * r[k, large]
    norm = math.sqrt(r[0, middle] ** 2 + r[1, middle] ** 2 + r[2, middle] ** 2)
    for k in range(3):
        r[k, middle] /= norm


@inlined(allocates=True)
def rotation_columns(a, r):
    """Proper rotation r (3, 3) along the orthogonal columns of a; returns the index of the smallest column.

    The smallest column only follows from the two others, with the sign that makes r proper. Columns that
    vanish are replaced by any that complete the rotation.
    """
    size = np.empty(3)
    for k in range(3):
        size[k] = math.sqrt(a[0, k] ** 2 + a[1, k] ** 2 + a[2, k] ** 2)
    small = 0
    for k in range(1, 3):
        if size[k] <= size[small]:
            small = k
    i, j = (small + 1) % 3, (small + 2) % 3
    if size[i] < size[j]:
        large, middle = j, i
    else:
        large, middle = i, j
    _fill_large(a, r, large, size[large])
    _fill_middle(a, r, large, middle, size[middle], not size[middle] > VANISHING * size[large])
    for k in range(3):  # (i, j, small) is an even permutation
        m, n = (k + 1) % 3, (k + 2) % 3
        r[k, small] = r[m, i] * r[n, j] - r[n, i] * r[m, j]
    return small


@inlined(allocates=True)
def rotation_part(f, r):
    """Proper rotation r nearest to f (3, 3): the polar decomposition's, for inverted and degenerate f too.

    Where f mirrors, the smallest stretch counts as negative (Irving, Teran and Fedkiw, SCA 2004).
    """
    a, v, u = np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    for k in range(3):
        v[k, k] = 1.0
        for l in range(3):
            a[k, l] = f[k, l]
    orthogonalize(a, v)  # v stays proper
    rotation_columns(a, u)
    for k in range(3):
        for l in range(3):
            r[k, l] = u[k, 0] * v[l, 0] + u[k, 1] * v[l, 1] + u[k, 2] * v[l, 2]


@inlined
def to_quaternion(r, q):
    """Unit quaternion q (w, x, y, z) of a proper rotation r, by its largest component (Shepperd 1978)."""
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    largest = 0
    for k in range(1, 4):
        this = r[k - 1, k - 1]
        best = trace if largest == 0 else r[largest - 1, largest - 1]
        if this > best:
            largest = k
    if largest == 0:
        q[0] = 1.0 + trace
        q[1], q[2], q[3] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = r[k, j] - r[j, k]
        q[1 + i] = 1.0 + r[i, i] - r[j, j] - r[k, k]
        q[1 + j] = r[j, i] + r[i, j]
        q[1 + k] = r[k, i] + r[i, k]
    norm = math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    for k in range(4):
        q[k] /= norm
