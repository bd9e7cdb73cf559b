"""From a suspect to the few assets worth holding it against: the index ranks all, the first are compared properly."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

from engine.catalogue.catalogue import Catalogue
from engine.model import Float32
from engine.registration.sketch import ALIKE, SuspectIndex

__all__ = ["Likeness", "screen_model", "screen_pictures"]

COMPARED = 32
"""Assets whose sketches are compared with a model, 5 to 15 ms each; as many again while there are alike ones among
them, so that near copies of an asset cannot hide it."""
MOST_COMPARED = 256
SHOWN = 2.0
"""Agreeing votes from which a picture shows an asset. Among 1,000 assets others had up to 0.83 in 360 pictures."""


@dataclass(frozen=True)
class Likeness:
    """An asset that a suspect may come from, and what speaks for it."""

    name: str
    votes: float  # of a model as `SuspectIndex.resemblance`, of pictures as `Catalogue.like_pictures`
    alike: bool  # whether that is more than strangers have


def screen_model(catalogue: Catalogue, suspect: SuspectIndex, among: Container[str] | None = None) -> list[Likeness]:
    """The likeliest assets that a model comes from, of those in question (all where None), the likeliest first."""
    names = [name for name in catalogue.like_model(suspect) if among is None or name in among]
    found: list[Likeness] = []
    for begin in range(0, min(len(names), MOST_COMPARED), COMPARED):
        votes = [(name, suspect.resemblance(catalogue.sketch(name))) for name in names[begin : begin + COMPARED]]
        found += [Likeness(name, float(count), count >= ALIKE) for name, count in votes]
        if max(count for _, count in votes) < ALIKE:
            break
    return sorted(found, key=lambda each: -each.votes)


def screen_pictures(
    catalogue: Catalogue, pictures: Sequence[Float32], among: Container[str] | None = None
) -> list[Likeness]:
    """The assets that pictures of one and the same may show, the likeliest first; those that no vote speaks for are
    left out."""
    ranked = catalogue.like_pictures(pictures)
    return [Likeness(name, votes, votes >= SHOWN) for name, votes in ranked if among is None or name in among]
