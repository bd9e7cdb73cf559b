"""Films that a person would rather look at than read: captioned frames as animated WebP."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from engine.lab.sim.views.encoders import bytes_of
from engine.model import Float32

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

__all__ = ["caption", "write_movie"]

Uint8 = npt.NDArray[np.uint8]

ACCENT = (46, 204, 137)
"""Colour of the stroke beside a caption, RGB."""
_INK, _FAINT = (255, 255, 255), (205, 211, 218)
_SHADE, _OPACITY = np.array([14.0, 18.0, 24.0]), 0.72
_WEBP_QUALITY = 82


def write_movie(path: Path, frames: Sequence[Uint8], fps: float) -> None:
    """Write frames (H, W, 3) of one size as a looping animated WebP, which counts in whole milliseconds."""
    from PIL import Image

    first, *rest = (Image.fromarray(frame) for frame in frames)
    pause = max(1, round(1000.0 / fps))
    first.save(path, "WEBP", save_all=True, append_images=rest, duration=pause, loop=0, quality=_WEBP_QUALITY, method=4)


def caption(frame: Float32, lines: Sequence[str]) -> Uint8:
    """A frame (H, W, 3), 0..1, in 8 bits with lines of text on a dark band at its foot.

    The first line is larger. A line that is too long for the frame is cut, with an ellipsis.
    """
    from PIL import Image, ImageDraw

    levels = bytes_of(frame)
    height, width = levels.shape[:2]
    size = max(9, round(0.042 * min(height, width)))
    fonts = [_font(round(1.2 * size), True)] + [_font(size, False)] * (len(lines) - 1)
    steps = [round(1.75 * size)] + [round(1.4 * size)] * (len(lines) - 1)
    margin = round(0.7 * size)
    top = max(0, height - sum(steps) - 2 * margin + round(0.4 * size))
    band = levels[top:].astype(np.float64)
    levels[top:] = np.round(band * (1.0 - _OPACITY) + _OPACITY * _SHADE).astype(np.uint8)
    picture = Image.fromarray(levels)
    pen = ImageDraw.Draw(picture)
    pen.rectangle((0, top, max(2, size // 4), height), fill=ACCENT)
    left, y = margin + size // 2, top + margin
    for number, (line, font, step) in enumerate(zip(lines, fonts, steps, strict=True)):
        pen.text((left, y), _cut(line, font, width - left - margin), font=font, fill=_FAINT if number else _INK)
        y += step
    return np.array(picture, dtype=np.uint8)


def _cut(line: str, font: FreeTypeFont, room: float) -> str:
    if font.getlength(line) <= room:
        return line
    while line and font.getlength(line + "…") > room:
        line = line[:-1]
    return line.rstrip() + "…"


@lru_cache(maxsize=16)
def _font(size: int, bold: bool) -> FreeTypeFont:
    """The face that matplotlib brings along: it is there on every machine and knows Greek and arrows."""
    from matplotlib import get_data_path
    from PIL import ImageFont

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(get_data_path(), "fonts", "ttf", name), size)
