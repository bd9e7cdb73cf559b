"""Pictures of a model as people post them, their camera drawn at random."""

from collections.abc import Iterator

import numpy as np

from engine.flows.views.camera_rig import UP, direction, measure_extent
from engine.lab.sim.attacks import image_attack
from engine.model import Float32, GaussianModel, look_at
from engine.raster import render_depth

__all__ = ["SIZES", "posted_pictures"]

SIZES = ((1280, 720), (960, 760), (540, 960))
"""Width and height, pixels."""


def posted_pictures(model: GaussianModel, count: int, rng: np.random.Generator) -> Iterator[Float32]:
    """JPEG 80 files (H, W, 3) of any view, roll and background, a quarter of them mirrored."""
    extent = measure_extent(model)
    flat = extent.axes[1] <= 0.2 * max(extent.axes[0], extent.axes[2])  # seen from the air, as it was captured
    for _ in range(count):
        width, height = SIZES[int(rng.integers(len(SIZES)))]
        lens = np.radians(rng.uniform(30.0, 75.0))
        toward = direction(
            rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(20.0, 75.0) if flat else rng.uniform(-5.0, 60.0))
        )
        distance = extent.radius / np.sin(0.5 * lens) / np.exp(rng.uniform(np.log(0.6), np.log(2.0)))
        target = extent.center + 0.2 * extent.radius * rng.normal(size=3)
        roll = rng.uniform(-np.pi, np.pi)
        up = UP * np.cos(roll) + np.cross(toward, UP) * np.sin(roll)
        focal = 0.5 * min(width, height) / np.tan(0.5 * lens)
        camera = look_at(target + distance * toward, target, up, focal, width, height)
        image, alpha, _ = render_depth(model, camera)
        behind = rng.uniform(0, 1, 3) * rng.uniform(0.3, 1.0, (height, 1, 1))
        picture = np.clip(image + (1.0 - alpha[..., None]) * behind, 0.0, 1.0).astype(np.float32)
        picture = picture[:, ::-1] if rng.random() < 0.25 else picture
        yield image_attack("jpeg").apply(np.ascontiguousarray(picture), 80)
