"""What a small picture says to the points of views: how well edges and colours of a pose are its own (DESIGN 4.8).

Directions of edges count without their sign, and colours by their correlation, so that neither what lies behind a model
nor the tone of a viewer matters much.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from engine.model import Camera, Float32, Float64, Int64
from engine.numerics.resampling import smooth
from engine.pictures.camera.camera_motion import swung
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.view_points import ViewPoints, gradient
from engine.pictures.camera.view_scores import BINS, PAD, SIDE, folded, look_again


@dataclass(frozen=True, eq=False)
class PictureEdges:
    """A picture reduced to `SIDE` pixels along its longer side."""

    small: Float32  # (h, w, 3), 0..1

    @classmethod
    def of(cls, picture: Float32) -> "PictureEdges":
        """Of a picture (H, W, 3), 0..1."""
        import cv2

        height, width = picture.shape[:2]
        factor = max(height, width) / SIDE
        shape = max(8, round(width / factor)), max(8, round(height / factor))
        small = cv2.resize(picture, shape, interpolation=cv2.INTER_AREA)
        return cls(np.asarray(small, dtype=np.float32))

    @cached_property
    def maps(self) -> npt.NDArray[np.int16]:
        """Responses for each direction of an edge, `folded`."""
        return folded(_responses(self._soft, CONFIG.edges.off))

    @cached_property
    def _near(self) -> Float32:
        return np.pad(_responses(self._soft, CONFIG.edges.off_again), [(0, 0), (PAD, PAD), (PAD, PAD)])

    @cached_property
    def _soft(self) -> Float32:
        return smooth(self.small, CONFIG.edges.soft)

    def placed(self, views: Sequence[ViewPoints], which: Int64, starts: Float64, steps: int) -> Float64:
        """Poses near those where views are thought to be at which edges fit best, and how well: (F, 5).

        `which` (F,) of the views it is, and its pose `starts` (F, 4): roll, radians; size, pixels; x, y of its middle,
        pixels of the small picture. The best may be 2 pixels off, and so many steps of 3.75 degrees and of 5.5 %.
        """
        finds, size = np.zeros((len(which), 5)), np.array(self.small.shape[:2])
        edges, directions = (stacked(views, name) for name in ("edges", "directions"))
        # One kernel for a column of finds and for views in a row.
        look_again(self._near, size, edges, directions, np.ascontiguousarray(which), starts, steps, finds)
        finds[:, 4] *= (finds[:, 1] / SIDE) ** CONFIG.edges.larger
        return finds

    def scored(self, views: Sequence[ViewPoints], which: Int64, starts: Float64) -> tuple[Float32, Float64]:
        """How well views fit in edges and colors: scores (F,), and the poses (F, 4) within two steps that fit best; see
        `placed`."""
        finds = self.placed(views, which, starts, 2)
        colored = self._colored(views, which, finds[:, :4])
        return finds[:, 4].astype(np.float32) + np.float32(CONFIG.edges.colored) * colored, finds[:, :4]

    def _colored(self, views: Sequence[ViewPoints], which: Int64, poses: Float64) -> Float32:
        """(F,) Fisher's transform of the correlation of colours, each channel from its own mean."""
        inner, colors = stacked(views, "inner")[which], stacked(views, "colors")[which]  # (F, P, 2), (F, P, 3)
        height, width = self.small.shape[:2]
        turn, size, x, y = poses.T[..., None]  # (F, 1) each
        across, down = inner[..., 0] * size, inner[..., 1] * size
        columns = np.floor(np.cos(turn) * across - np.sin(turn) * down + x + 0.5).astype(np.int64)
        rows = np.floor(np.sin(turn) * across + np.cos(turn) * down + y + 0.5).astype(np.int64)
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        seen = self._soft[np.where(inside, rows, 0), np.where(inside, columns, 0)]  # (F, P, 3)
        count = np.maximum(inside.sum(axis=1), 1)[:, None]
        seen, drawn = (
            (each - (each * inside[..., None]).sum(axis=1, keepdims=True) / count[..., None]) * inside[..., None]
            for each in (seen, colors)
        )
        both = np.sqrt(np.square(seen).sum(axis=(1, 2)) * np.square(drawn).sum(axis=(1, 2)))
        alike = (seen * drawn).sum(axis=(1, 2)) / np.maximum(both, 1e-6)
        clipped = np.clip(alike, -CONFIG.edges.most_alike, CONFIG.edges.most_alike)
        return np.where(count[:, 0] >= CONFIG.edges.least_colors, np.arctanh(clipped), 0.0).astype(np.float32)

    def camera(self, view: ViewPoints, pose: Float64) -> Camera:
        """The camera of the small picture that stands where the view's did and shows it at this pose (4,), with a lens
        to make the size right."""
        turn, size, x, y = pose
        return swung(view.camera, view.middle, np.array([x, y]) + 0.5, turn, size / view.spread, self.small.shape)


def stacked(views: Sequence[ViewPoints], name: str) -> Float32:
    """(V, ...) one field of all views."""
    return np.stack([getattr(view, name) for view in views])


def _responses(soft: Float32, reach: int) -> Float32:
    """(BINS, h, w) what a blurred picture says for each direction of an edge at each place."""
    import cv2

    size, *steps = gradient(soft)
    turns = np.arctan2(*steps)
    weight = size / (size + 0.5 * np.quantile(size, 0.8) + 0.004)
    maps = np.empty((BINS, *size.shape), dtype=np.float32)
    window = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
    for b in range(BINS):
        alike = np.maximum(np.cos(2.0 * (turns - np.pi * b / BINS)), 0.0)
        spread = cv2.dilate(np.asarray(weight * alike * alike, dtype=np.float32), window)
        maps[b] = (spread - spread.mean()) / max(float(spread.std()), 1e-3)
    return maps
