"""Which of several pictures do not show what the others do: that of an unmarked original, or of another copy.

Two pictures of one marked model answer alike to each chip, whatever its sign is: the product of their evidence knows no
secret, since every sign enters twice. How much they should agree follows from their responses (`PictureEvidence`). So
whom to leave out is a function of the suspect alone, and costs no tries (DESIGN 4.9).
"""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from engine.model import Float64
from engine.watermark.config import CONFIG
from engine.watermark.image_evidence import PictureEvidence

_CONFIG = CONFIG.evidence


class Together:
    """Pictures of one asset, summed but for those that contradict the others."""

    def __init__(self) -> None:
        self._parts: dict[int, PictureEvidence] = {}
        self._compared = True

    def add(self, number: int, part: PictureEvidence) -> None:
        """One more picture, by its number."""
        self._parts[number] = part
        if len(self._parts) * part.nbytes > _CONFIG.most_kept:
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

    None where they are fewer than three, or where no more of them agree, by a clear reading, than would be left out.
    """
    left_out: list[int] = []
    if len(pictures) < _CONFIG.least_pictures:
        return ()
    shown = [np.multiply(picture.weights, picture.held_y, dtype=np.float64) for picture in pictures]
    expected = [np.multiply(picture.weights, picture.held_response, dtype=np.float64) for picture in pictures]
    while 2 * len(left_out) < len(pictures):
        staying = [number for number in range(len(pictures)) if number not in left_out]
        shares = {number: _share(number, staying, shown, expected) for number in staying}
        known = {number: share for number, share in shares.items() if share is not None}
        odd = min(known, key=lambda number: known[number], default=None)
        if odd is None or known[odd] >= _CONFIG.agrees:
            return tuple(left_out) if len(known) > len(left_out) else ()
        left_out.append(odd)
    return ()


def _share(one: int, staying: Sequence[int], shown: Sequence[Float64], expected: Sequence[Float64]) -> float | None:
    """How much of the expected agreement with the others a picture comes to; None where chance may give as much."""
    rest = [number for number in staying if number != one]
    others = np.sum([shown[number] for number in rest], axis=0)
    promised = float(expected[one] @ np.sum([expected[number] for number in rest], axis=0))
    chance = float(np.linalg.norm(shown[one] * others))
    return float(shown[one] @ others) / promised if promised > _CONFIG.expected_agreement * chance else None
