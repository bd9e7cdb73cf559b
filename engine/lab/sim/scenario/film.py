"""Pictures of a scenario: a captioned one after each step, and one film (animated WebP) through all steps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.image_encoders import bytes_of
from engine.lab.sim.scenario.script import Film
from engine.lab.sim.scenario.state import Finding, Outcome, viewpoint
from engine.model import Float32, GaussianModel
from engine.raster import render

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont


Uint8 = npt.NDArray[np.uint8]

ACCENT = (46, 204, 137)  # color of the stroke next to a caption, RGB
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


TURN = 75.0  # how far the camera walks round the scene in one step, degrees

ELEVATION = 22.0

FOLLOW = (0.2, 2.5)  # a model that has grown or shrunk beyond these factors, or left the picture, is looked at anew


class Show:
    """Draws one step after the other; the camera walks on from where it was, at first around `model`."""

    def __init__(self, film: Film, model: GaussianModel) -> None:
        self.frames: list[Uint8] = []
        self._film = film
        self._extent = measure_extent(model)
        self._azimuth = 0.0

    def add(self, label: str, outcome: Outcome, findings: Sequence[Finding]) -> Uint8:
        """Draw a step; its last picture comes back, its frames join the film."""
        lines = [label, *(finding_text(finding) for finding in findings)]
        if outcome.pictures:
            shown = [self._fitted(picture) for picture in outcome.pictures]
            hold = max(1, self._film.frames // len(shown))
            moments = [picture for picture in shown for _ in range(hold)]
        else:
            still = outcome.world.flat() if outcome.shown is None else outcome.shown
            models = outcome.frames or (still,) * max(self._film.frames, 1)
            self._follow(models[-1])
            moments = []
            for model in models:
                camera = viewpoint(self._extent, self._azimuth, ELEVATION, *self._film.size)
                moments.append(np.clip(render(model, camera), 0.0, 1.0))
                self._azimuth += TURN / len(models)
        drawn = [caption(moment, lines) for moment in moments]
        if self._film.frames:
            self.frames += drawn
        return drawn[-1]

    def _follow(self, model: GaussianModel) -> None:
        now, before = measure_extent(model), self._extent
        away = np.linalg.norm(now.center - before.center) / before.radius
        if away > 1.0 or not FOLLOW[0] < now.radius / before.radius < FOLLOW[1]:
            self._extent = now

    def _fitted(self, picture: Float32) -> Float32:
        """A picture of any size in the middle of a frame."""
        width, height = self._film.size
        factor = min(width / picture.shape[1], height / picture.shape[0])
        size = (max(1, round(picture.shape[1] * factor)), max(1, round(picture.shape[0] * factor)))
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR)
        frame = np.full((height, width, 3), 0.15, dtype=np.float32)
        top, left = (height - size[1]) // 2, (width - size[0]) // 2
        frame[top : top + size[1], left : left + size[0]] = small
        return frame


def finding_text(finding: Finding) -> str:
    """What was found of one record, in a few words."""
    verdict = "MARKED" if finding.verdict == "marked" else finding.verdict.replace("_", " ")
    return f"{finding.object}: {verdict}, {finding.matching_bits}/{finding.bits} bits, z {finding.z:.0f}"
