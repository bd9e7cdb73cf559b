"""For which code vectors each suspect Gaussian speaks, and what all of them say about each.

A Gaussian matched to one of the reference's speaks for that one's code vector; a merged one for those of all its parts,
by their shares of its mass. Least squares gives y = sum of t s e / sum of t s^2 over the suspect Gaussians, with share
s, trust t and residual e: the weighted mean where every share is 1.
"""

# mypy: allow-untyped-defs

import numpy as np

from engine.kernels.jit import kernel
from engine.model import Float32, Float64, Int32, Int64
from engine.watermark.config import CONFIG


class CodeShares:
    """Shares of the code vectors of one stage in n suspect Gaussians."""

    def __init__(self, rows: Int64, codes: Int32, shares: Float64, shape: tuple[int, int]) -> None:
        """Entries (E,) of a sparse matrix of `shape` (n, code vectors); those of one place add up."""
        self.count, self.codes = shape
        columns: Int64 = codes.astype(np.int64)
        if len(rows) and np.bincount(rows).max() > 1:
            place, entry = np.unique(rows * self.codes + columns, return_inverse=True)
            rows, columns = place // self.codes, place % self.codes
            shares = np.bincount(entry, shares).astype(np.float64)
        self.entries = rows, columns, shares

    def _sums(self, values: Float64, power: int = 1) -> Float64:
        """(codes, K) sums over suspect Gaussians of their shares to a power times values (n, K)."""
        rows, codes, shares = self.entries
        return combined(codes, rows, shares**power, values, self.codes)

    def _shown(self, means: Float64) -> Float64:
        """(n, K) sums over code vectors of shares times means (codes, K)."""
        rows, codes, shares = self.entries
        return combined(rows, codes, shares, means, self.count)

    def means(self, values: Float64, trust: Float64) -> Float64:
        """(codes, 3) displacement of each code vector from residuals (n, 3), those of other code vectors left aside."""
        total = self._sums(trust[:, None], 2)
        return np.asarray(self._sums(trust[:, None] * values) / np.maximum(total, 1e-12))

    def explained(self, means: Float64, values: Float64, trust: Float64) -> Float64:
        """(n, 3) part of the residuals that displacements (codes, 3) stand for.

        Where Gaussians speak for several code vectors each of these was given all of the residual: one factor, by least
        squares, sees to it that together they explain no more than there is. It is 1 where every share is.
        """
        shown = self._shown(means)
        weighted = trust[:, None] * shown
        energy = float((weighted * shown).sum())
        factor = float((weighted * values).sum()) / energy if energy > 0 else 0.0
        return np.asarray(min(max(factor, 0.0), 1.0) * shown)

    def variance(self, left: Float64, trust: Float64) -> Float64:
        """(codes, R) variance of each mean, from the errors (n, R) of suspect Gaussians along the carriers.

        Infinity for code vectors without members.
        """
        total, squared = self._sums(np.stack([trust, trust**2], axis=1), 2).T
        members = total**2 / np.maximum(self._sums(trust[:, None] ** 2, 4)[:, 0], 1e-300)  # as many as weigh alike
        overall = (trust[:, None] * left**2).sum(axis=0) / max(float(trust.sum()), 1e-12)  # (R,)
        own = self._sums(trust[:, None] * left**2, 2) / np.maximum(total, 1e-12)[:, None]
        spread = (members[:, None] * own + CONFIG.evidence.blend * overall) / (members[:, None] + CONFIG.evidence.blend)
        seen = total > 1e-9
        effective = np.where(seen, squared / np.maximum(total, 1e-12) ** 2, 0.0)
        return np.where(seen[:, None], spread * effective[:, None], np.inf)


def combined(into: Int64, origin: Int64 | Int32, shares: Float64, values: Float64 | Float32, count: int) -> Float64:
    """(count, K) sums of shares (E,) of rows `origin` (E,) of values (M, K), to rows `into` (E,)."""
    sums = np.zeros((count, values.shape[1]))
    _combine(into, origin.astype(np.int64, copy=False), shares, np.ascontiguousarray(values, np.float64), sums)
    return sums


@kernel
def _combine(into, origin, shares, values, sums):
    for e in range(len(into)):
        for k in range(values.shape[1]):
            sums[into[e], k] += shares[e] * values[origin[e], k]
