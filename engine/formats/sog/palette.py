"""A palette for the spherical harmonics of SOG: up to 65,536 code vectors, learnt in seconds.

A flat k-means would compare every Gaussian with every code vector. Here a first k-means splits the
Gaussians into about sqrt(P) groups, and each group gets its own k-means with a share of the code vectors
proportional to its squared error; an assignment then costs 2 sqrt(P) comparisons instead of P, for some 5 %
more squared error.
"""

# mypy: allow-untyped-defs

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.kernels.thread_crew import thread_count
from engine.model import Float32, Float64, Int64

_SAMPLE = 1 << 16
_GROUP_ROUNDS, _CODE_ROUNDS = 8, 4
_SEED = 0x50A1E77E


def palette_size(count: int) -> int:
    """Code vectors that PlayCanvas's writer takes for so many Gaussians: to 64k, at most one for each."""
    return max(1, int(min(64.0, 2.0 ** np.floor(np.log2(max(count, 1) / 1024.0))) * 1024))


def learn_palette(vectors: Float32, size: int) -> tuple[Float32, Int64]:
    """Code vectors (P, d) float32, P <= size, and labels (N,) int64 of small squared error for vectors (N, d), N >= 1.

    The same for the same input on any number of threads. Vectors of which no more than `size` (1 to N) differ, as those
    of a vector-quantised scene, are kept exactly. Codes of one group are neighbours, so that the labels of alike
    Gaussians are close.
    """
    vectors = np.ascontiguousarray(vectors, dtype=np.float32)
    exact = _distinct(vectors, size)
    if exact is not None:
        return exact
    groups = _groups(vectors, max(1, round(size**0.5)))
    count = int(groups.max()) + 1
    order = np.argsort(groups, kind="stable")
    held = np.bincount(groups, minlength=count)
    error = _group_errors(vectors, groups, held)
    share = np.floor(error / max(float(error.sum()), 1e-300) * (size - count)).astype(np.int64)
    codes_of_group = np.minimum(1 + share, np.maximum(held, 1))
    rows = np.concatenate([[0], np.cumsum(held)])
    slots = np.concatenate([[0], np.cumsum(codes_of_group)])
    codes = np.zeros((slots[-1], vectors.shape[1]), dtype=np.float32)
    sorted_labels = np.zeros(len(vectors), dtype=np.int64)
    scratch = _room(vectors.shape[1], int(held.max()), int(codes_of_group.max()))
    _refine_groups(vectors[order], rows, codes, slots, sorted_labels, _CODE_ROUNDS, scratch)
    labels = np.empty_like(sorted_labels)
    labels[order] = sorted_labels
    return codes, labels


def _distinct(vectors: Float32, limit: int) -> tuple[Float32, Int64] | None:
    """The different rows and which of them each row is, if there are no more than `limit`."""
    keys = np.empty(len(vectors), dtype=np.uint64)
    _hash_rows(vectors.view(np.uint32), keys)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    if len(first) > limit:
        return None
    codes = vectors[first]
    if not (codes[inverse] == vectors).all():  # two different rows with the same key
        return None
    return codes, inverse.astype(np.int64)


@parallel_kernel
def _hash_rows(bits, keys, call):
    """A rolling hash of each row, modulo 2^64."""
    for i in share_of(len(keys), call):
        key = np.uint64(0)
        for k in range(bits.shape[1]):
            key = (key ^ np.uint64(bits[i, k])) * np.uint64(0x9E3779B97F4A7C15)
            key ^= key >> np.uint64(29)
        keys[i] = key


def _groups(vectors: Float32, count: int) -> Int64:
    """(N,) group of each row: k-means learnt on a sample."""
    rng = np.random.default_rng(_SEED)
    sample = vectors[np.sort(rng.choice(len(vectors), min(_SAMPLE, len(vectors)), replace=False))]
    centers = sample[rng.choice(len(sample), min(count, len(sample)), replace=False)]
    for _ in range(_GROUP_ROUNDS):
        labels = _nearest(sample, centers)
        held = np.bincount(labels, minlength=len(centers))[:, None]
        means = _group_sums(sample, labels, len(centers)) / np.maximum(held, 1)
        centers = np.where(held > 0, means, centers).astype(np.float32)
    return _nearest(vectors, centers)


def _group_sums(values: npt.NDArray[Any], labels: Int64, count: int) -> Float64:
    return np.stack([np.bincount(labels, column, count) for column in values.T], axis=1)


def _group_errors(vectors: Float32, groups: Int64, held: npt.NDArray[Any]) -> Float64:
    """Squared error of each group's mean: sum |x|^2 - n |mean|^2."""
    count = len(held)
    sums = _group_sums(vectors, groups, count)
    squares = np.bincount(groups, np.einsum("nd,nd->n", vectors, vectors, dtype=np.float64), count)
    return np.asarray(np.maximum(squares - (sums**2).sum(axis=1) / np.maximum(held, 1), 0.0))


def _nearest(vectors: Float32, centers: Float32) -> Int64:
    labels = np.empty(len(vectors), dtype=np.int64)
    half = (0.5 * (centers.astype(np.float64) ** 2).sum(axis=1)).astype(np.float32)
    scores = np.empty((thread_count(), len(half)), dtype=np.float32)
    _nearest_kernel(vectors, np.ascontiguousarray(centers.T), half, scores, labels)
    return labels


@parallel_kernel
def _nearest_kernel(vectors, centers, half, scores, labels, call):
    """argmin |c|^2 / 2 - x.c for each row; centres (d, P), so that the innermost loop runs over lanes."""
    dims, count = centers.shape
    score = scores[call[0]]
    for i in share_of(len(vectors), call):
        for j in range(count):
            score[j] = half[j]
        for k in range(dims):
            v = vectors[i, k]
            for j in range(count):
                score[j] -= v * centers[k, j]
        best = 0
        for j in range(1, count):
            if score[j] < score[best]:
                best = j
        labels[i] = best


def _room(dims: int, members: int, codes: int) -> tuple[npt.NDArray[Any], ...]:
    """Scratch of `_refine_groups` for each thread: groups have at most so many members and codes."""
    threads = thread_count()
    books, scores = np.empty((threads, dims, codes), np.float32), np.empty((threads, 2, codes), np.float32)
    errors, sums = np.empty((threads, members), np.float32), np.empty((threads, codes, dims))
    return books, scores, errors, sums, np.empty((threads, members), np.int64), np.empty((threads, codes), np.int64)


@inlined
def _assign_codes(vectors, first, book, half, score, own, error):
    """Nearest code `own` (M,) of each of the vectors from `first` on, and its squared `error` (n,); book (d, P)."""
    dims, count = book.shape
    half[:] = 0.0
    for k in range(dims):
        for j in range(count):
            half[j] += np.float32(0.5) * book[k, j] * book[k, j]
    for i in range(len(error)):
        for j in range(count):
            score[j] = half[j]
        square = np.float32(0.0)
        for k in range(dims):
            v = vectors[first + i, k]
            square += v * v
            for j in range(count):
                score[j] -= v * book[k, j]
        best = 0
        for j in range(1, count):
            if score[j] < score[best]:
                best = j
        own[i], error[i] = best, square + np.float32(2.0) * score[best]


@inlined
def _update_codes(vectors, first, book, own, error, sums, held):
    """Moves each code to the mean of its vectors; an idle one to the vector with the largest error."""
    dims, count = book.shape
    for j in range(count):
        held[j] = 0
        for k in range(dims):
            sums[j, k] = 0.0
    for i in range(len(error)):
        held[own[i]] += 1
        for k in range(dims):
            sums[own[i], k] += vectors[first + i, k]
    for j in range(count):
        if held[j] > 0:
            for k in range(dims):
                book[k, j] = sums[j, k] / held[j]
        elif len(error) > 0:
            worst = np.argmax(error)
            error[worst] = 0.0
            for k in range(dims):
                book[k, j] = vectors[first + worst, k]


@parallel_kernel
def _refine_groups(vectors, rows, codes, slots, labels, rounds, scratch, call):
    """k-means inside every group; rows and slots bound the vectors and the codes of group g; `scratch` from `_room`."""
    dims = vectors.shape[1]
    mine = call[0]
    for g in share_of(len(rows) - 1, call):
        first, n = rows[g], rows[g + 1] - rows[g]
        slot, count = slots[g], slots[g + 1] - slots[g]
        book, half, score = scratch[0][mine][:, :count], scratch[1][mine, 0, :count], scratch[1][mine, 1, :count]
        error, sums, own, held = scratch[2][mine, :n], scratch[3][mine], scratch[4][mine], scratch[5][mine]
        for j in range(count):
            for k in range(dims):
                book[k, j] = vectors[first + j * n // count, k] if n > 0 else np.float32(0.0)
        for step in range(rounds + 1):
            _assign_codes(vectors, first, book, half, score, own, error)
            if step < rounds:
                _update_codes(vectors, first, book, own, error, sums, held)
        for i in range(n):
            labels[first + i] = slot + own[i]
        for j in range(count):
            for k in range(dims):
                codes[slot + j, k] = book[k, j]
