"""The copy layer: displacements on top of the owner's, by which recipients' copies differ (DESIGN 4.5).

Its values are drawn from a bell curve by the key of one copy (`spreading.spread_copy`), on cells and Gaussians that all
copies share, on top of the owner's layer, which is in all copies. So k copies give k equations in k + 1 unknowns:
however they are put together, what is left carries the owner's layer and the mean of their own.
"""

from dataclasses import dataclass, replace

import numpy as np

from engine.model import Bool, Float32, Float64, Int32, Int64
from engine.watermark.code_shares import combined
from engine.watermark.grain import ATTRIBUTES, Grain
from engine.watermark.layout import Layout
from engine.watermark.model_evidence import Evidence, Residual
from engine.watermark.spreading import Spreading, spread_copy


@dataclass(frozen=True, eq=False)
class CopyLayer:
    """Where and how far copies may differ; all copies of an asset have one layer in common."""

    layout: Layout
    grain: Grain

    def at(self, rows: Int64 | Int32) -> "CopyLayer":
        """Of these Gaussians alone."""
        return replace(self, layout=self.layout.at(rows))

    def spreading(self, subkey: bytes, kept: Bool | None, gaussians: int) -> Spreading:
        """The chips of one copy, of tint and grain.

        Parameters
        ----------
        subkey : bytes
            Of that copy.
        kept : (M,) bool, optional
            Which Gaussians of the committed reference are still needed.
        gaussians : int
            M, or of the reference where all are.
        """
        tint = spread_copy(subkey, self.layout.chips, "tint")
        if not self.grain.there:
            return tint
        grain = spread_copy(subkey, ATTRIBUTES * gaussians, "grain")
        if kept is not None:
            grain = grain.of(np.repeat(kept, ATTRIBUTES))
        return tint.then(grain)

    def displacements(self, values: Float64) -> tuple[Float32, Float64 | None]:
        """What chips of these values displace colors (N, D) by, and centers and sizes (6 N,), None without a grain."""
        tint, grain = np.split(values, [self.layout.chips])
        shift = self.layout.displace(self.layout.amplitudes * tint)
        return shift, self.grain.displacements(grain) if self.grain.there else None


def without_owner(found: Residual, owner: Float64) -> Residual:
    """Differences of colors without as much of the owner's layer as they hold.

    The signs of one layer are fair whatever those of the other are, so who traces may know the owner's.

    Parameters
    ----------
    owner : (N, D) float64
        Displacement of each reference Gaussian by the owner's layer.
    """
    count, width = found.values.shape
    shown = combined(found.rows, found.reference_rows, found.shares, owner[:, :width], count)
    return replace(found, values=found.values - _share(found.values, shown, found.trust[:, None]) * shown)


def grain_without_owner(said: Evidence, owner: Float64) -> Evidence:
    """The same of centers and sizes: evidence of the grain (6 N,), and what the owner's layer moves them by."""
    weights = said.weights if said.linear is None else np.minimum(said.weights, said.linear)
    return replace(said, y=said.y - _share(said.y, owner, weights) * owner)


def _share(shown: Float64, layer: Float64, weights: Float64) -> float:
    """By least squares, 0 to 1, how much of a layer is in what is shown."""
    energy = float((weights * layer * layer).sum())
    return min(max(float((weights * layer * shown).sum()) / energy, 0.0), 1.0) if energy > 0 else 0.0
