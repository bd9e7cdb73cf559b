"""Kernels of the hypotheses: which candidates agree, and what a similarity of three of them explains."""

# mypy: allow-untyped-defs

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from engine.kernels.jit import inlined, kernel, parallel_kernel, share_of
from engine.kernels.thread_crew import thread_count
from engine.model import Float64, Int32, Int64
from engine.registration.config import Agreement

BINS = 48
"""Tolerances tried per hypothesis: powers of sqrt(2) below the reference's extent."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """n candidates: places in the suspect, x, and in the reference, y (n, 3); `size` (n,), the log of the reference's
    size over the suspect's; and `turn` (n, 4), the unit quaternion of their rotation, reference after suspect."""

    x: Float64
    y: Float64
    size: Float64
    turn: Float64

    def __len__(self) -> int:
        return len(self.x)

    def shuffled(self, order: Int64) -> "Pairs":
        """The suspect's places paired with other places of the reference."""
        return Pairs(self.x, self.y[order], self.size[order], self.turn)

    def columns(self) -> Float64:
        """(12, n): x (3), y (3), size, the factor that it is the logarithm of, turn (4)."""
        parts = [self.x, self.y, self.size[:, None], np.exp(self.size)[:, None], self.turn]
        return np.ascontiguousarray(np.concatenate(parts, axis=1).T)


class Triples(NamedTuple):
    """The best triple around each of n seeds: R (n, 3, 3), (scale, t) (n, 4), evidence, bin and tries (n,) each."""

    turns: Float64
    moves: Float64
    scores: Float64
    bins: Int64
    tries: Int64


@inlined
def _agree(c, i, j, tol_size, wide, cos_half, cos_line):
    """Whether two candidates agree; without a branch, so that loops over j run in vector registers. `wide` is the
    square of the ratio by which lengths may be off."""
    ax, ay, az = c[0, j] - c[0, i], c[1, j] - c[1, i], c[2, j] - c[2, i]
    bx, by, bz = c[3, j] - c[3, i], c[4, j] - c[4, i], c[5, j] - c[5, i]
    la, lb = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz
    grown = la * c[7, i] * c[7, j]
    fits = (abs(c[6, i] - c[6, j]) <= tol_size) & (la > 0.0) & (lb > 0.0)
    fits &= (lb <= grown * wide) & (grown <= lb * wide)
    w, p, q, r = c[8, i], c[9, i], c[10, i], c[11, i]
    cosine = abs(w * c[8, j] + p * c[9, j] + q * c[10, j] + r * c[11, j])
    # v + 2 u x (u x v + w v): the line from i to j, turned as i turned
    tx, ty, tz = 2 * (q * az - r * ay), 2 * (r * ax - p * az), 2 * (p * ay - q * ax)
    along = (ax + w * tx + q * tz - r * ty) * bx + (ay + w * ty + r * tx - p * tz) * by
    along += (az + w * tz + p * ty - q * tx) * bz
    turned = (cosine >= cos_half) & (along >= cos_line * math.sqrt(la * lb))
    return fits & ((cos_half < 0.0) | turned)


def degrees_of_agreement(pairs: Pairs, rules: Agreement) -> Int32:
    """With how many others each candidate agrees, (n,) int32."""
    out = np.zeros(len(pairs), np.int32)
    count_agreeing(pairs.columns(), rules.size, math.exp(2.0 * rules.edge), *rules.cosines, out)
    return out


@parallel_kernel
def count_agreeing(columns, tol_size, wide, cos_half, cos_line, out, call):
    """`degrees_of_agreement`, to `out`."""
    for i in share_of(len(out), call):
        count = 0
        for j in range(len(out)):  # no pair agrees with itself: the length is 0
            count += _agree(columns, i, j, tol_size, wide, cos_half, cos_line)
        out[i] = count


@kernel
def _frame(p, out):
    """Orthonormal frame of a triangle p (3, 3) into out (rows); False if it is degenerate."""
    ux, uy, uz = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
    vx, vy, vz = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    lu, lv = math.sqrt(ux * ux + uy * uy + uz * uz), math.sqrt(vx * vx + vy * vy + vz * vz)
    ln = math.sqrt(nx * nx + ny * ny + nz * nz)
    if ln <= 0.1 * lu * lv or ln == 0.0:  # flatter than 6 degrees: the rotation about the line is noise
        return False
    out[0, 0], out[0, 1], out[0, 2] = ux / lu, uy / lu, uz / lu
    out[2, 0], out[2, 1], out[2, 2] = nx / ln, ny / ln, nz / ln
    out[1, 0] = out[2, 1] * out[0, 2] - out[2, 2] * out[0, 1]
    out[1, 1] = out[2, 2] * out[0, 0] - out[2, 0] * out[0, 2]
    out[1, 2] = out[2, 0] * out[0, 1] - out[2, 1] * out[0, 0]
    return True


@kernel
def _triple(x, y, i, j, k, turn, moved, room):
    """Similarity of three pairs: R into turn, (scale, t) into moved; False if degenerate. `room` (4, 3, 3): scratch."""
    a, b, fa, fb = room[0], room[1], room[2], room[3]
    for c in range(3):
        a[0, c], a[1, c], a[2, c] = x[i, c], x[j, c], x[k, c]
        b[0, c], b[1, c], b[2, c] = y[i, c], y[j, c], y[k, c]
    if not _frame(a, fa) or not _frame(b, fb):
        return False
    la, lb = 0.0, 0.0
    for c in range(3):
        la += (a[1, c] - a[0, c]) ** 2 + (a[2, c] - a[0, c]) ** 2 + (a[2, c] - a[1, c]) ** 2
        lb += (b[1, c] - b[0, c]) ** 2 + (b[2, c] - b[0, c]) ** 2 + (b[2, c] - b[1, c]) ** 2
    scale = math.sqrt(lb / la)
    moved[0] = scale
    for r in range(3):
        for c in range(3):
            turn[r, c] = fb[0, r] * fa[0, c] + fb[1, r] * fa[1, c] + fb[2, r] * fa[2, c]
    for r in range(3):
        t = 0.0
        for v in range(3):
            t += b[v, r] - scale * (turn[r, 0] * a[v, 0] + turn[r, 1] * a[v, 1] + turn[r, 2] * a[v, 2])
        moved[1 + r] = t / 3.0
    return True


def evidence(
    pairs: Pairs, turn: Float64, moved: Float64, tol_size: float, extent: float, chance: Float64
) -> tuple[float, int]:
    """Best log likelihood ratio of a similarity, R and (scale, t), over the tolerances, and which; after Moisan and
    Stival, IJCV 2004."""
    columns = np.ascontiguousarray(np.concatenate([pairs.x, pairs.y, pairs.size[:, None]], axis=1).T)
    errors = np.empty(len(pairs))
    best, at = weigh(columns, turn, moved, tol_size, extent, chance, np.zeros(BINS), errors, errors.view(np.int64))
    return float(best), int(at)


@kernel
def weigh(c, turn, moved, tol_size, extent, chance, counts, errors, bits):
    """`evidence`; `counts` (BINS,) and `errors` (n,) are scratch, `bits` are those of the errors."""
    log_scale, unit, s = math.log(moved[0]), 1.0 / (extent * extent), moved[0]
    sized = 0
    for i in range(len(errors)):
        e = 0.0
        for r in range(3):
            d = s * (turn[r, 0] * c[0, i] + turn[r, 1] * c[1, i] + turn[r, 2] * c[2, i]) + moved[1 + r] - c[3 + r, i]
            e += d * d
        fits = abs(c[6, i] - log_scale) <= tol_size
        sized += fits
        errors[i] = e * unit if fits else 2.0  # beyond all tolerances
    for b in range(BINS):
        counts[b] = 0.0
    for i in range(len(errors)):
        # floor(-log2) is what the exponent says, and one less where anything follows the leading digit
        bin_ = 1023 - (bits[i] >> 52) - ((bits[i] & 0xFFFFFFFFFFFFF) != 0)
        if bin_ >= 0:
            counts[min(bin_, BINS - 1)] += 1.0
    best, at, total = 0.0, -1, 0.0
    for b in range(BINS - 1, -1, -1):
        total += counts[b]
        k = total - 3.0  # the three that made the hypothesis fit by construction
        expected = sized * chance[b]
        if k > expected:
            ratio = k * math.log(k / expected) - (k - expected)
            if ratio > best:
                best, at = ratio, b
    return best, at


def best_triples(
    pairs: Pairs, rules: Agreement, extent: float, chance: Float64, *, seeds: Int64, draws: int, seed: int
) -> Triples:
    """Best of so many triples drawn around each of the candidates `seeds`."""
    count = len(seeds)
    turns, moves = np.zeros((count, 3, 3)), np.zeros((count, 4))
    scores, bins, tries = np.zeros(count), np.full(count, -1, np.int64), np.zeros(count, np.int64)
    limits, found = (rules.size, rules.edge, *rules.cosines, extent), Triples(turns, moves, scores, bins, tries)
    threads, errors = thread_count(), np.empty((thread_count(), len(pairs)))
    room = np.empty((threads, 5, 3, 3)), np.empty((threads, 4 + BINS)), errors, errors.view(np.int64)
    friends = np.empty((threads, len(pairs)), np.int64)
    columns, scratch = pairs.columns(), (friends, *room)
    draw_triples(pairs.x, pairs.y, columns, seeds, draws, limits, chance, seed, scratch, tuple(found))
    return found


@inlined
def _compatible(columns, i, tol_size, wide, cos_half, cos_line, friends):
    """Number of matches that agree with match i; their indices go to `friends`."""
    many = 0
    for j in range(len(friends)):
        if _agree(columns, i, j, tol_size, wide, cos_half, cos_line):
            friends[many] = j
            many += 1
    return many


@parallel_kernel
def draw_triples(x, y, columns, seeds, draws, rules, chance, seed, scratch, found, call):
    """`best_triples`, to `found`, which holds zeros, and -1 in the bins."""
    friends, room = scratch[0][call[0]], scratch[1][call[0]]
    R, moved, counts = room[4], scratch[2][call[0], :4], scratch[2][call[0], 4:]
    errors, bits, size = scratch[3][call[0]], scratch[4][call[0]], columns[6]
    tol_size, tol_edge, cos_half, cos_line, extent = rules
    wide = math.exp(2.0 * tol_edge)
    turns, moves, scores, bins, tries = found
    for s in share_of(len(seeds), call):
        i = seeds[s]
        many = _compatible(columns, i, tol_size, wide, cos_half, cos_line, friends)
        if many < 2:
            continue
        state = np.uint64(seed) + np.uint64(0x9E3779B97F4A7C15) * np.uint64(i + 1)
        for _ in range(draws):
            # splitmix64: a stream of its own for every seed, so that threads do not matter
            state += np.uint64(0x9E3779B97F4A7C15)
            z = state
            z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            z = z ^ (z >> np.uint64(31))
            j = friends[np.int64((z & np.uint64(0xFFFFFFFF)) % np.uint64(many))]
            k = friends[np.int64((z >> np.uint64(32)) % np.uint64(many))]
            if not _agree(columns, j, k, tol_size, wide, cos_half, cos_line):
                continue
            if not _triple(x, y, i, j, k, R, moved, room):
                continue
            if abs(math.log(moved[0]) - (size[i] + size[j] + size[k]) / 3.0) > tol_edge:
                continue
            tries[s] += 1
            score, at = weigh(columns, R, moved, tol_size, extent, chance, counts, errors, bits)
            if score > scores[s]:
                scores[s], bins[s] = score, at
                for a in range(3):
                    for b in range(3):
                        turns[s, a, b] = R[a, b]
                for a in range(4):
                    moves[s, a] = moved[a]
