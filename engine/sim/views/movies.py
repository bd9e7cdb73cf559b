"""Films that a person would rather look at than read: captioned frames as animated WebP, or MP4 with ffmpeg."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.sim.views.camera_paths import fly_through, orbit
from engine.sim.views.video_tools import encode_video

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

__all__ = ["caption", "fly_through", "orbit", "write_movie"]

Uint8 = npt.NDArray[np.uint8]

ACCENT = (46, 204, 137)
"""Colour of the stroke beside a caption, RGB."""
_INK, _FAINT = (255, 255, 255), (205, 211, 218)
_SHADE, _OPACITY = np.array([14.0, 18.0, 24.0]), 0.72
_WEBP_QUALITY = 82
_H264 = ("-c:v", "libx264", "-preset", "medium", "-crf", "18")


def write_movie(
    path: str | Path,
    frames: Sequence[npt.NDArray[Any]],
    fps: float = 12.0,
    *,
    kind: Literal["webp", "mp4"] | None = None,
) -> None:
    """Write frames as a film.

    Parameters
    ----------
    path : str or Path
    frames : sequence of (H, W, 3) uint8, or float 0..1
        At least one, all of one size.
    fps : float
        Frames a second, above 0 and at most 100. A WebP film counts in whole milliseconds.
    kind : {"webp", "mp4"}, optional
        "webp" is an animated WebP that loops; "mp4" is H.264 with 4:2:0 chroma and needs the ffmpeg command. By the
        name where not given.

    Raises
    ------
    InputError
        If there is no frame, the frames differ in size, the kind is unknown or ffmpeg is needed and not here.
    """
    path = Path(path)
    wanted = kind or path.suffix.lower().lstrip(".")
    if wanted not in ("webp", "mp4"):
        raise InputError(f"a film is written as .webp or .mp4, got {str(path)!r}")
    if not 0 < fps <= 100:
        raise InputError(f"frames a second must lie above 0 and at most 100, got {fps}")
    if not frames:
        raise InputError("a film needs at least one frame")
    levels = [_levels(frame) for frame in frames]
    sizes = {frame.shape for frame in levels}
    if len(sizes) > 1:
        raise InputError(f"the frames of a film must have one size, got {sorted(sizes)}")
    if wanted == "mp4":
        path.write_bytes(encode_video(levels, fps, _H264))
        return
    from PIL import Image

    first, *rest = (Image.fromarray(frame) for frame in levels)
    first.save(
        path,
        "WEBP",
        save_all=True,
        append_images=rest,
        duration=max(1, round(1000.0 / fps)),
        loop=0,
        quality=_WEBP_QUALITY,
        method=4,
    )


def caption(frame: npt.NDArray[Any], lines: Sequence[str], accent: tuple[int, int, int] = ACCENT) -> Uint8:
    """Draw lines of text on a dark band at the foot of a frame.

    Parameters
    ----------
    frame : (H, W, 3) uint8, or float 0..1
    lines : sequence of str
        The first one, the headline, is larger. A line that is too long for the frame is cut, with an ellipsis.
    accent : (3,) of int
        Colour of the stroke at the left, 0..255.

    Returns
    -------
    (H, W, 3) uint8
        A fresh frame; without lines a copy.

    Raises
    ------
    InputError
        If the frame is not one.
    """
    from PIL import Image, ImageDraw

    levels = _levels(frame).copy()
    if not lines:
        return levels
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
    pen.rectangle((0, top, max(2, size // 4), height), fill=accent)
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


def _levels(frame: npt.NDArray[Any]) -> Uint8:
    if frame.ndim != 3 or frame.shape[2] != 3 or frame.size == 0:
        raise InputError(f"a frame is (H, W, 3), got shape {frame.shape}")
    if frame.dtype == np.uint8:
        return np.ascontiguousarray(frame)
    if not np.issubdtype(frame.dtype, np.floating):
        raise InputError(f"a frame is uint8, or float from 0 to 1, got {frame.dtype}")
    return np.asarray(np.round(np.clip(frame, 0.0, 1.0) * 255.0), dtype=np.uint8)
