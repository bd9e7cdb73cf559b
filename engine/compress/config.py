"""Tuned constants of how a model is reduced, a frozen config (DESIGN 4.2 to 4.4)."""

from dataclasses import dataclass

__all__ = ["CONFIG", "CompressConfig"]


@dataclass(frozen=True)
class CompressConfig:
    """Uncertainty (`impact`), near-duplicates (`duplicate_merging`), `cells` and `levels_of_detail`."""

    prior: float = 1e-3  # precision of the Laplace approximation, squared blending weights: unseen ones stay finite
    color_gap: float = 0.15  # largest DC difference of a pair that may be merged, SH units (about 0.04 in color),
    shape_gap: float = 0.35  # and largest relative difference of its covariances (Frobenius)
    color_weight: float = 0.06  # of a unit of DC color against the scene's radius, where cells are split
    neighbors: int = 12  # nearest Gaussians among which a partner is sought for a coarser level of detail
    color_std: float = 0.2  # difference of SH coefficients that costs such a pair as much as half a nat of shape
    thin: float = 1e-8  # share of its trace added to a covariance, so that discs have a determinant


CONFIG = CompressConfig()
