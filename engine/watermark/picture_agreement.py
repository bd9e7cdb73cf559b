"""Which of several pictures do not show what the others do: that of an unmarked original, or of another copy.

Two pictures of one marked model answer alike to each chip, whatever its sign is: the product of their evidence knows no
secret, since every sign enters twice. How much they should agree follows from their responses (`PictureEvidence`). So
whom to leave out is a function of the suspect alone, and costs no tries (DESIGN 4.9).
"""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from engine.model import Float64
from engine.watermark.image_evidence import PictureEvidence

__all__ = ["Together", "find_contradicting"]

LEAST_PICTURES = 3
"""Of two that disagree, either may be the wrong one."""
TOLD = 6.0
"""Standard deviations of chance by which a picture must be expected to agree with the others before it is judged."""
AGREES = 0.3
"""Share of what is expected that a picture of the same mark comes to at least: with one in four that shows another mark
they come to 1 and more, that one to 0.1 at most."""

MOST_KEPT = 1 << 30
"""Bytes of single pictures' evidence that may be kept to compare them: 38 pictures of a hundred thousand Gaussians with
a grain. Beyond that they are summed as they come, and none is left out."""


class Together:
    """Pictures of one asset, summed but for those that contradict the others."""

    def __init__(self) -> None:
        self._parts: dict[int, PictureEvidence] = {}
        self._compared = True

    def add(self, number: int, part: PictureEvidence) -> None:
        """One more picture, by its number."""
        self._parts[number] = part
        if len(self._parts) * part.nbytes > MOST_KEPT:
            self._compared = False
        if not self._compared:
            self._parts = {number: reduce(PictureEvidence.plus, self._parts.values())}

    def agreed(self) -> tuple[PictureEvidence | None, tuple[int, ...]]:
        """What they say, None where there are none; and the numbers of those left out."""
        if not self._parts:
            return None, ()
        numbers = list(self._parts)
        places = find_contradicting(list(self._parts.values())) if self._compared else ()
        odd = tuple(sorted(numbers[place] for place in places))
        return reduce(PictureEvidence.plus, (self._parts[n] for n in numbers if n not in odd)), odd


def find_contradicting(pictures: Sequence[PictureEvidence]) -> tuple[int, ...]:
    """Numbers, from 0, of the pictures of one asset that do not show the mark of the others, the least alike first.

    None where they are fewer than three, or where no more of them agree, told well enough, than would be left out.
    """
    left_out: list[int] = []
    if len(pictures) < LEAST_PICTURES:
        return ()
    shown = [np.multiply(picture.weights, picture.held_y, dtype=np.float64) for picture in pictures]
    expected = [np.multiply(picture.weights, picture.held_response, dtype=np.float64) for picture in pictures]
    while 2 * len(left_out) < len(pictures):
        staying = [number for number in range(len(pictures)) if number not in left_out]
        shares = {number: _share(number, staying, shown, expected) for number in staying}
        told = {number: share for number, share in shares.items() if share is not None}
        odd = min(told, key=lambda number: told[number], default=None)
        if odd is None or told[odd] >= AGREES:
            return tuple(left_out) if len(told) > len(left_out) else ()
        left_out.append(odd)
    return ()


def _share(one: int, staying: Sequence[int], shown: Sequence[Float64], expected: Sequence[Float64]) -> float | None:
    """How much of the expected agreement with the others a picture comes to; None where that tells nothing."""
    rest = [number for number in staying if number != one]
    others = np.sum([shown[number] for number in rest], axis=0)
    promised = float(expected[one] @ np.sum([expected[number] for number in rest], axis=0))
    chance = float(np.linalg.norm(shown[one] * others))
    return float(shown[one] @ others) / promised if promised > TOLD * chance else None
