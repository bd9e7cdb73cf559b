"""The best 256 values for many: the scalar codebooks of SOG."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.model import Float32, Float64

LEVELS = 256
_BINS = 1 << 14
_ROUNDS = 300


def learn_codebook(
    values: npt.NDArray[Any], weights: npt.NDArray[Any] | None = None, levels: int = LEVELS
) -> Float32:
    """Values of least squared error to the nearest, by Lloyd's iteration on all data.

    The start is the optimal high-rate quantiser, whose points lie as the cube root of the density (Panter and
    Dite 1951); prefix sums over the sorted values then make a round cost 256 binary searches, so that it runs
    until nothing moves. Values that take at most `levels` different numbers are kept exactly.

    Parameters
    ----------
    values : (...)
        Finite numbers, at least one.
    weights : (...), optional
        How often each counts; of the shape of `values`, not negative, not all zero.
    levels : int
        Length of the codebook.

    Returns
    -------
    (levels,) float32
        Ascending; padded with the largest value where fewer are needed.
    """
    flat = np.asarray(values, dtype=np.float32).reshape(-1)
    order = None if weights is None else np.argsort(flat, kind="stable")
    x = np.sort(flat) if order is None else flat[order]
    distinct = x[np.flatnonzero(np.diff(x, prepend=np.float32(np.nan)) != 0)]
    if len(distinct) <= levels:
        return np.concatenate([distinct, np.full(levels - len(distinct), distinct[-1], dtype=np.float32)])
    w = np.ones(len(x)) if weights is None or order is None else np.asarray(weights).reshape(-1)[order]
    mass = np.concatenate([[0.0], np.cumsum(w, dtype=np.float64)])
    moment = np.concatenate([[0.0], np.cumsum(w * x.astype(np.float64))])
    centres = _start(x, w, levels)
    for _ in range(_ROUNDS):
        split = np.searchsorted(x, _edges(centres))
        bounds = np.concatenate([[0], split, [len(x)]])
        held = np.diff(mass[bounds])
        means = np.diff(moment[bounds]) / np.where(held > 0, held, 1.0)
        moved = np.sort(np.where(held > 0, means, centres))
        if (moved.astype(np.float32) == centres.astype(np.float32)).all():
            break
        centres = moved
    return centres.astype(np.float32)


def nearest_codes(values: npt.NDArray[Any], codebook: Float32) -> npt.NDArray[np.uint8]:
    """Index of the nearest entry of an ascending codebook of at most 256, for values of any shape."""
    edges = _edges(codebook.astype(np.float64)).astype(np.float32)
    return np.searchsorted(edges, values.astype(np.float32)).astype(np.uint8)


def _edges(centres: Float64) -> Float64:
    middle: Float64 = 0.5 * (centres[1:] + centres[:-1])
    return middle


def _start(x: Float32, w: npt.NDArray[Any], levels: int) -> Float64:
    """(levels,) points at equal steps of the integral of density^(1/3); x ascending, not constant."""
    low, high = float(x[0]), float(x[-1])
    bins = np.minimum(((x - low) * (_BINS / (high - low))).astype(np.int64), _BINS - 1)
    density = np.cbrt(np.bincount(bins, w, _BINS))
    steps = np.concatenate([[0.0], np.cumsum(density)])
    wanted = (np.arange(levels) + 0.5) / levels * steps[-1]
    return np.asarray(np.interp(wanted, steps, np.linspace(low, high, _BINS + 1)))
