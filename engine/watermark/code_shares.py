"""For which code vectors each suspect Gaussian speaks, and what all of them say about each.

A Gaussian matched to one of the reference's speaks for that one's code vector; a merged one for those of all its parts,
by their shares of its mass. Least squares gives y = sum of t s e / sum of t s^2 over the suspect Gaussians, with share
s, trust t and residual e: the weighted mean where every share is 1.
"""

import numpy as np
import scipy

from engine.model import Float64, Int32, Int64

_BLEND = 4.0
"""A few members say little about their own spread: the whole scene's is blended in, worth so many members."""


class CodeShares:
    """Shares of the code vectors of one stage in n suspect Gaussians."""

    def __init__(self, rows: Int64, codes: Int32, shares: Float64, shape: tuple[int, int]) -> None:
        """Entries (E,) of a sparse matrix of `shape` (n, code vectors); those of one place add up."""
        self.matrix = scipy.sparse.csr_matrix((shares, (rows, codes)), shape=shape)
        self.squared = self.matrix.multiply(self.matrix).tocsr()

    def means(self, values: Float64, trust: Float64) -> Float64:
        """(codes, 3) displacement of each code vector from residuals (n, 3), those of other code vectors left aside."""
        total = self.squared.T @ trust
        return np.asarray((self.matrix.T @ (trust[:, None] * values)) / np.maximum(total, 1e-12)[:, None])

    def explained(self, means: Float64, values: Float64, trust: Float64) -> Float64:
        """(n, 3) part of the residuals that displacements (codes, 3) stand for.

        Where Gaussians speak for several code vectors each of these was given all of the residual: one factor, by least
        squares, sees to it that together they explain no more than there is. It is 1 where every share is.
        """
        shown = self.matrix @ means
        weighted = trust[:, None] * shown
        energy = float((weighted * shown).sum())
        factor = float((weighted * values).sum()) / energy if energy > 0 else 0.0
        return np.asarray(min(max(factor, 0.0), 1.0) * shown)

    def variance(self, left: Float64, trust: Float64) -> Float64:
        """(codes, R) variance of each mean, from the errors (n, R) of suspect Gaussians along the carriers.

        Infinity for code vectors for which nobody speaks.
        """
        total = self.squared.T @ trust
        squared = self.squared.T @ trust**2
        members = total**2 / np.maximum(self.squared.power(2).T @ trust**2, 1e-300)  # as many as weigh alike
        overall = (trust[:, None] * left**2).sum(axis=0) / max(float(trust.sum()), 1e-12)  # (R,)
        own = (self.squared.T @ (trust[:, None] * left**2)) / np.maximum(total, 1e-12)[:, None]
        spread = (members[:, None] * own + _BLEND * overall) / (members[:, None] + _BLEND)
        seen = total > 1e-9
        effective = np.where(seen, squared / np.maximum(total, 1e-12) ** 2, 0.0)
        return np.where(seen[:, None], spread * effective[:, None], np.inf)
