"""What a person looks at: a captioned picture after each step, and the frames of one film through all of them."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.scenario.script import Film
from engine.lab.sim.scenario.world import Outcome, viewpoint
from engine.lab.sim.views.movies import caption
from engine.model import Float32, GaussianModel
from engine.raster import render

__all__ = ["Show"]

Uint8 = npt.NDArray[np.uint8]

TURN = 75.0
"""How far the camera walks round the scene in one step, degrees."""

ELEVATION = 22.0

FOLLOW = (0.2, 2.5)
"""A model that has grown or shrunk beyond these factors, or left the picture, is looked at anew."""


class Show:
    """Draws one step after the other; the camera walks on from where it was, at first around `model`."""

    def __init__(self, film: Film, model: GaussianModel) -> None:
        self.frames: list[Uint8] = []
        self._film = film
        self._extent = measure_extent(model)
        self._azimuth = 0.0

    def add(self, label: str, outcome: Outcome, rows: Sequence[dict[str, Any]]) -> Uint8:
        """Draw a step; its last picture comes back, its frames join the film."""
        lines = [label, *(finding(row) for row in rows)]
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


def finding(row: dict[str, Any]) -> str:
    """What was found of one record, in a few words."""
    words = {"marked": "MARKED", "not_marked": "not marked", "inconclusive": "inconclusive"}[row["verdict"]]
    return f"{row['object']}: {words}, {row['matching_bits']}/{row['bits']} bits, z {row['z']:.0f}"
