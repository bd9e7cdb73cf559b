"""Where a curve over strengths falls below a level: interpolated, with an interval from resampled trials."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.model import Float64
from engine.sim.attack import Strength

__all__ = ["Break", "breaking_point", "first_below", "interpolate", "strength_at"]

GEOMETRIC = 8.0
"""Strengths of one sign whose ends differ by this factor are interpolated by ratio, others by difference."""


@dataclass(frozen=True)
class Break:
    """Where the level is lost, in steps of the sweep (0 is its first strength); infinite where it never is.

    Parameters
    ----------
    low, high : float
        95 % interval over resampled trials.
    """

    step: float
    low: float
    high: float
    trials: int

    @property
    def lost(self) -> bool:
        """Whether the sweep got that far."""
        return math.isfinite(self.step)


def first_below(curve: Sequence[float] | Float64, level: float) -> float:
    """Step at which a piecewise linear curve first falls below a level; inf where it never does."""
    values = np.asarray(curve, dtype=np.float64)
    below = np.flatnonzero(values < level)
    if not len(below):
        return math.inf
    k = int(below[0])
    if k == 0:
        return 0.0
    return float(k - 1 + (values[k - 1] - level) / (values[k - 1] - values[k]))


def breaking_point(curves: Float64, level: float, *, draws: int = 1_000, seed: int = 0) -> Break:
    """Where the mean of several trials' curves falls below a level.

    Parameters
    ----------
    curves : (trials, steps)
    draws : int
        Resamples of the trials.
    """
    picks = np.random.default_rng(seed).integers(len(curves), size=(draws, len(curves)))
    drawn = np.sort([first_below(curves[pick].mean(axis=0), level) for pick in picks])
    low, high = drawn[int(0.025 * (draws - 1))], drawn[math.ceil(0.975 * (draws - 1))]
    return Break(first_below(curves.mean(axis=0), level), float(low), float(high), len(curves))


def strength_at(strengths: Sequence[Strength], step: float) -> float | None:
    """The strength at a step between those of a sweep; None beyond it, or where strengths are names."""
    if not math.isfinite(step) or any(isinstance(value, str) for value in strengths):
        return None
    return interpolate(np.array(strengths, dtype=np.float64), step)


def interpolate(values: Float64, step: float) -> float:
    """Between neighbours by ratio where they are of one sign and span a wide range, by difference otherwise."""
    at = np.arange(len(values))
    if (values > 0).all() and values.max() >= GEOMETRIC * values.min():
        return float(np.exp(np.interp(step, at, np.log(values))))
    return float(np.interp(step, at, values))
