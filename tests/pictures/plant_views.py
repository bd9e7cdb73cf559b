"""Views of the plant, and how far off a camera found in a picture of one is."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from engine.model import Camera, GaussianModel, look_at
from engine.pictures.camera.camera_motion import project
from engine.pictures.landmarks.rendered_landmarks import lift
from engine.raster import render_depth

UP = np.array([0.0, -1.0, 0.0])


def around(model: GaussianModel, azimuth: float, elevation: float, distance: float, focal: float) -> Camera:
    """A view of 480 x 360 pixels; angles in degrees, distance in sizes of the model, focal length in widths."""
    a, e = np.radians(azimuth), np.radians(elevation)
    low, high = np.quantile(model.means.astype(np.float64), [0.1, 0.9], axis=0)
    toward = np.array([np.cos(a) * np.cos(e), -np.sin(e), np.sin(a) * np.cos(e)])
    center, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    up = UP + 0.06 * np.array([np.sin(7 * a), 0.0, np.cos(5 * a)])
    return look_at(center + distance * size * toward, center, up, 480 * focal, 480, 360)


def jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    buffer = io.BytesIO()
    Image.fromarray(np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)).save(buffer, "JPEG", quality=quality)
    return np.asarray(Image.open(buffer), dtype=np.float32) / 255


def reprojection(model: GaussianModel, true: Camera, found: Camera) -> float:
    """Root mean square distance of surface points between two cameras' pictures, pixels."""
    _, alpha, depth = render_depth(model, true)
    row, column = np.nonzero(alpha > 0.7)
    pixels = np.stack([column + 0.5, row + 0.5], axis=1)
    points = lift(pixels, depth[row, column].astype(np.float64), true)
    return float(np.sqrt(np.mean(np.sum((project(points, found) - pixels) ** 2, axis=1))))
