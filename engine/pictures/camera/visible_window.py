"""Where in a picture a camera sees a model, and how well a reduced render correlates with it there (DESIGN 4.8)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.model import Bool, Camera, Float32, GaussianModel
from engine.numerics.resampling import resized, smooth
from engine.pictures.alignment.detail import correlation
from engine.pictures.camera.config import CONFIG
from engine.pictures.landmarks.keypoints import luma
from engine.raster import render_depth

__all__ = ["Window"]

_CONFIG = CONFIG.keypoints


@dataclass(frozen=True, eq=False)
class Window:
    """The part of a picture that shows a model and its surroundings, and by how much it is enlarged."""

    rows: slice
    columns: slice
    picture: Camera  # of the whole
    factor: float
    shown: Bool  # (h, w) of the part, much reduced: the model, and what is near
    resemblance: float  # of picture and render there, -1 to 1

    @classmethod
    def around(cls, model: GaussianModel, camera: Camera, gray: Float32) -> Window | None:
        """Where a camera sees the model, in a picture of this brightness (H, W); None where it does not."""
        import cv2

        small = camera.with_side(_CONFIG.glance_side)
        image, alpha, _ = render_depth(model, small)
        seen = alpha > _CONFIG.glance_alpha
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if not len(rows):
            return None
        low, high = np.array([rows[0], columns[0]]), np.array([rows[-1], columns[-1]]) + 1
        margin = int(np.ceil(_CONFIG.surroundings * (high - low).max()))
        near = cv2.dilate(seen.astype(np.uint8), np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)) > 0
        low, high = np.maximum(low - margin, 0), np.minimum(high + margin, seen.shape)
        shown = near[low[0] : high[0], low[1] : high[1]]
        scale = np.array([camera.height / small.height, camera.width / small.width])
        (top, left), (bottom, right) = np.floor(low * scale).astype(int), np.ceil(high * scale).astype(int)
        factor = max(1.0, _CONFIG.closer_side / max(bottom - top, right - left))
        alike = _resemblance(resized(gray, small.width, small.height), luma(image), alpha)
        return cls(slice(int(top), int(bottom)), slice(int(left), int(right)), camera, float(factor), shown, alike)

    def of(self, camera: Camera) -> Camera:
        """The camera of this part of its picture."""
        K = camera.K.copy()
        K[:2, 2] -= self.columns.start, self.rows.start
        K[:2] *= self.factor
        width, height = (round(self.factor * (part.stop - part.start)) for part in (self.columns, self.rows))
        return Camera(camera.viewmat, K, width, height)

    def back(self, camera: Camera) -> Camera:
        """The camera of the whole picture, of this part's."""
        K = camera.K / self.factor
        K[:2, 2] += self.columns.start, self.rows.start
        K[2, 2] = 1.0
        return Camera(camera.viewmat, K, self.picture.width, self.picture.height)


def _resemblance(seen: Float32, drawn: Float32, alpha: Float32) -> float:
    """The larger correlation, -1 to 1, of brightness within the model and of its steps there and at its outline: a
    picture (h, w), and a render of this opacity. Tone curves spoil the first, many leaves the second."""
    import cv2

    inside = alpha > _CONFIG.glance_alpha
    side = 2 * _CONFIG.outline + 1
    around = cv2.dilate(inside.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    behind = float(np.median(seen[~around])) if not around.all() else 0.0
    seen, drawn = (smooth(each, _CONFIG.soft) for each in (seen, drawn + (1.0 - alpha) * np.float32(behind)))
    steps = (np.hypot(*np.gradient(each))[around] for each in (seen, drawn))
    return max(correlation(seen[inside], drawn[inside]), correlation(*steps))
