"""Image bars: one picture from a known camera under each attack, and screenshots whose camera nobody knows."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from engine.evaluate.bars_models import row
from engine.evaluate.marked_scene import MarkedScene
from engine.model import Camera, Float32, GaussianModel, look_at
from engine.pipeline.rigs import make_rig, measure_extent
from engine.pipeline.verification import VerifyConfig, verify_images
from engine.raster import render
from engine.sim.attacks import image_attack

IMAGE_BARS: tuple[tuple[str, str, float], ...] = (
    ("JPEG 10", "jpeg", 10),
    ("noise std 0.1", "noise_image", 0.1),
    ("rotation 30 deg", "rotate_image", 30.0),
    ("scale 0.75", "scale_image", 0.75),
    ("crop 40 % of the area", "crop_image", 0.4),
    ("blur sigma 1", "blur", 1.0),
    ("brightness 0.5", "brightness", 0.5),
    ("brightness 1.5", "brightness", 1.5),
)
"""Label, attack and strength ("literal" readings)."""


def to_8_bit(image: Float32) -> Float32:
    """What a stored picture holds."""
    return (np.round(np.clip(image, 0, 1) * 255) / 255).astype(np.float32)


def bench_image_attacks(scene: MarkedScene, views: int | None = None, seed: int = 0) -> list[dict[str, Any]]:
    """Every image bar on single 800x800 pictures from the key views."""
    rows = []
    cameras = scene.opened.cameras[:views]
    for k, camera in enumerate(cameras):
        picture = to_8_bit(render(scene.marked, camera))
        for name, attack, strength in (("none", "", 0.0), *IMAGE_BARS):
            rng = np.random.default_rng((seed, k))
            suspect = to_8_bit(image_attack(attack).apply(picture, strength, rng=rng)) if attack else picture
            began = time.perf_counter()
            result = verify_images([suspect], scene.opened, VerifyConfig(), cameras=[camera])
            rows.append({"scene": scene.name, "view": k, **row(name, result, time.perf_counter() - began)})
    return rows


def random_view(model: GaussianModel, rng: np.random.Generator, width: int, height: int) -> Camera:
    """A view a person might take: around the object or in the room, any focal length of 0.7 to 1.5 widths."""
    extent = measure_extent(model)
    base = make_rig(model, 1, width, height, jitter=rng.random((1, 4)), extent=extent)[0]
    eye = base.position
    target = extent.center + rng.normal(0.0, 0.1, 3) * extent.radius
    if extent.is_room:
        target = eye + base.viewmat[2, :3] * extent.radius
    eye = target + (eye - target) * rng.uniform(0.7, 1.2)
    up = np.array([0.0, -1.0, 0.0]) + rng.normal(0.0, 0.08, 3)
    return look_at(eye, target, up, rng.uniform(0.7, 1.5) * width, width, height)


def bench_screenshots(
    scene: MarkedScene,
    trials: int = 50,
    seed: int = 0,
    foreign: Callable[[], GaussianModel] | None = None,
    advance: Callable[[float], None] | None = None,
) -> list[dict[str, Any]]:
    """800x600 screenshots, JPEG 80, camera and focal length unknown; of `foreign` where given."""
    source = foreign() if foreign else scene.marked
    rows = []
    for trial in range(trials):
        rng = np.random.default_rng((seed, trial))
        camera = random_view(source, rng, 800, 600)
        picture = image_attack("jpeg").apply(to_8_bit(render(source, camera)), 80, rng=rng)
        began = time.perf_counter()
        result = verify_images([picture], scene.opened, VerifyConfig())
        rows.append({"scene": scene.name, "trial": trial, **row("screenshot", result, time.perf_counter() - began)})
        if advance:
            advance((trial + 1) / trials)
    return rows
