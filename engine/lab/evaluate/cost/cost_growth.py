"""How fast a cost grows: cost = c * size^k, fitted on logarithms."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import linregress, t

__all__ = ["Growth", "fit_growth"]


@dataclass(frozen=True)
class Growth:
    """Exponent k with its 95 % interval (None with fewer than three points), and the factor c."""

    exponent: float
    interval: tuple[float, float] | None
    factor: float

    def __str__(self) -> str:
        if self.interval is None:
            return f"{self.exponent:.2f}"
        return f"{self.exponent:.2f} ({self.interval[0]:.2f} to {self.interval[1]:.2f})"


def fit_growth(sizes: Sequence[float], costs: Sequence[float]) -> Growth:
    """Least squares of log cost on log size; the interval is Student's, from the scatter about the line.

    ValueError with fewer than two sizes, or something that is not positive.
    """
    x, y = np.asarray(sizes, dtype=np.float64), np.asarray(costs, dtype=np.float64)
    if len(np.unique(x)) < 2 or len(x) != len(y):
        raise ValueError(f"a growth needs two sizes or more, got {list(sizes)} with {len(y)} costs")
    if (x <= 0).any() or (y <= 0).any():
        raise ValueError("sizes and costs must be positive")
    line = linregress(np.log(x), np.log(y))
    interval = None
    if len(x) > 2:
        half = float(t.ppf(0.975, len(x) - 2) * line.stderr)
        interval = (float(line.slope) - half, float(line.slope) + half)
    return Growth(float(line.slope), interval, float(np.exp(line.intercept)))
