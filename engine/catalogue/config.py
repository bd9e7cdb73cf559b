"""Tuned constants of the index over assets, a frozen config (DESIGN 4.9)."""

from dataclasses import dataclass

__all__ = ["CONFIG", "CatalogueConfig"]


@dataclass(frozen=True)
class CatalogueConfig:
    """Entries, nearest vectors, and what a match is."""

    looks: int = 512  # Gaussians of a sketch that the index knows
    # By which features of places are measured: their spread over seven real scenes, alike for both scales
    place_spread: tuple[float, ...] = (0.2, 0.2, 0.2, 0.2, 0.15, 0.12, 0.27, 0.05, 0.05, 0.05)
    teachers: int = 200  # assets from which the lists are learnt, at most
    keypoints: int = 1500  # of a picture, the strongest
    loudest: int = 400  # views whose votes are checked for agreement
    # Assets whose sketches are compared with a model, 5 to 15 ms each; as many again while there are alike ones among
    # them, so that near copies of an asset cannot hide it
    compared: int = 32
    most_compared: int = 256
    shown: float = 2.0  # agreeing votes from which a picture shows an asset: others of 1,000 had 0.83 in 360 pictures
    points: int = 2880  # of an asset at most, as many of each view: 132 bytes a point make 380 kB
    same_place: float = 4.0  # distance of landmarks of two views that are one, pixels at the usual distance
    # Distance of their descriptors (length 512) at most: those of two places are 380 to 450 in the median
    same_look: float = 300.0
    neighbors: int = 16  # landmarks near one that are compared, itself among them
    nearest: int = 8  # vectors that are counted for a query; the next one is the yardstick
    few: int = 40_000  # vectors that are compared one by one
    most_lists: int = 2048  # into which more vectors are sorted
    probes: int = 16  # lists that are searched
    lessons: int = 8  # rounds in which the middles of lists are learnt


CONFIG = CatalogueConfig()
