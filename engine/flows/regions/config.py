"""Tuned constants of the search for marked regions, frozen (DESIGN 4.10); the tests' own are in `RegionConfig`."""

from dataclasses import dataclass

__all__ = ["CONFIG", "RegionSearchConfig"]


@dataclass(frozen=True)
class RegionSearchConfig:
    """What counts as seen, and how a region is measured."""

    faint: float = 0.02  # share of what pictures say that is left to the faintest leaves: they count as not seen
    wide: float = 0.9  # share of a region's Gaussians within its radius


CONFIG = RegionSearchConfig()
