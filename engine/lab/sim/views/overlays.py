"""Attacks that lay something over a picture: the lettering of a preview, and a pattern against who reads it.

Image attacks as in `engine.lab.sim.image_attacks`. What they draw grows with the picture, so that it covers the same
of it.
"""

import numpy as np

from engine.lab.sim.attack import Attacks
from engine.model import Float32

__all__ = ["ATTACKS"]

ATTACKS: Attacks[Float32] = Attacks("image")

LETTERS = "PREVIEW"
SLANT = 30.0
"""Degrees by which the lettering rises."""
LINE = 0.08
"""From one line of it to the next, longer sides of the picture; letters are a third as high."""
CHEQUER = 0.011
"""Side of a field, longer sides of the picture: between what pixels and what whole parts of a model are made of."""


@ATTACKS.add(
    "white lettering all over, as on previews that are for sale", "opacity", 0.3, (0.1, 0.2, 0.3, 0.45, 0.6), "[0, 1]"
)
def lettering(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Slanted lines of words, every other shifted by half a word."""
    letters = _letters(*image.shape[:2])[..., None]
    return image + np.float32(strength) * letters * (1.0 - image)


@ATTACKS.add(
    "fields of a chessboard, lighter and darker", "change of brightness", 0.02, (0.01, 0.02, 0.04, 0.06, 0.08), "[0, 1]"
)
def chequers(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """A coarse pattern that no coder takes off again."""
    height, width = image.shape[:2]
    side = max(1.0, CHEQUER * max(height, width))
    rows, columns = ((np.arange(count) // side).astype(np.int64) for count in (height, width))
    board = np.where((rows[:, None] + columns) % 2, np.float32(strength), np.float32(-strength))
    return image + board[..., None]


def _letters(height: int, width: int) -> Float32:
    """(H, W) how far a pixel is covered."""
    import cv2

    side = max(height, width)
    line = max(6.0, LINE * side)
    face, scale = cv2.FONT_HERSHEY_DUPLEX, line / 3.0 / 22.0  # its capitals are 22 pixels high
    word = cv2.getTextSize(LETTERS, face, scale, 1)[0][0] + line
    reach = int(np.ceil(np.hypot(height, width)))  # however it is turned, the corners are covered
    sheet = np.zeros((reach, reach), dtype=np.uint8)
    for number, y in enumerate(np.arange(line, reach + line, line)):
        for x in np.arange(-0.5 * word * (number % 2), reach, word):
            thick = max(1, round(scale * 2.0))
            cv2.putText(sheet, LETTERS, (round(float(x)), round(float(y))), face, scale, 255, thick, cv2.LINE_AA)
    turn = cv2.getRotationMatrix2D((reach / 2, reach / 2), SLANT, 1.0)
    turn[:, 2] += (width - reach) / 2, (height - reach) / 2
    turned = cv2.warpAffine(sheet, turn, (width, height), flags=cv2.INTER_LINEAR)
    return np.asarray(turned, dtype=np.float32) / np.float32(255.0)
