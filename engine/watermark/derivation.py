"""Derivation: whether a suspect was made from the registered asset, whatever became of the mark (DESIGN 4.9).

A finding of its own, made without any chip: it stands where a mark was removed, and with an attested registration it is
what a takedown needs.
"""

from dataclasses import dataclass

Corner = tuple[float, float, float]


@dataclass(frozen=True)
class Derivation:
    """How much of the registered asset is in a suspect, how exactly and where."""

    derived: bool  # the asset, or a piece of it, was recognised in the suspect
    # Share of the reference's Gaussians that were found; None where the route does not measure it
    share: float | None = None
    gaussians: int | None = None  # Gaussians of the suspect that were recognised; None likewise
    # Median distance of a recognised Gaussian from where the reference has it, in that Gaussian's own standard
    # deviations; None where there is no one similarity, or nothing was matched
    exactness: float | None = None
    # Box around what was found, its 1 % and 99 % quantiles along each axis, in the reference's coordinates
    where: tuple[Corner, Corner] | None = None
    views: tuple[int, int] | None = None  # pictures in which it was recognised, of so many looked at


NOT_FOUND = Derivation(False)
"""Nothing of the asset was recognised."""
