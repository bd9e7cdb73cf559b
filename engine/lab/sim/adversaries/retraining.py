"""Training a fresh model on renders of a stolen one: none of its Gaussians is left, only what it looks like.

1. The thief renders the stolen model from views of his own choice.
2. Points come from the depths of these renders, or from nowhere (random), and make round Gaussians.
3. All parameters are trained on the renders, as on photos (`engine.lab.sim.capture.training`).

Nobody has published what becomes of a mark then. Reading it is informed as all our reading is: the owner's record says
what the unmarked model looked like; blind decoders do without.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from engine.errors import InputError
from engine.lab.sim.capture.capture_kernels import kernels_from_points
from engine.lab.sim.capture.training import TrainConfig, Trainer
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render, render_depth

__all__ = ["RetrainConfig", "quality_lost", "retrain", "retraining_steps"]

LEAST_ALPHA = 0.5
"""A pixel this opaque shows a surface, on which a point may lie."""
PHOTO_DB = 27.0
"""What a trained model usually reaches on photos it has not seen (27.2 dB, Mip-NeRF 360 scenes, Kerbl et al. 2023)."""


@dataclass(frozen=True)
class RetrainConfig:
    """Knobs of the attack."""

    points: int = 50_000  # Gaussians to start from
    # points on the surfaces that the renders' depths show, or anywhere in their midst
    start: Literal["depth", "random"] = "depth"
    opacity: float = 0.5  # of every Gaussian at the start, in (0, 1)
    # of the training; `train.steps` renders are shown
    train: TrainConfig = field(
        default_factory=lambda: TrainConfig(steps=3_000, sh_degree=0, densify=None, opacity_rate=0.02)
    )
    seed: int = 0  # of the points chosen

    def __post_init__(self) -> None:
        if self.points < 100:
            raise InputError(f"points is {self.points}, expected at least 100")
        if self.start not in ("depth", "random"):
            raise InputError(f"start must be 'depth' or 'random', got {self.start!r}")


def retrain(
    marked: GaussianModel,
    cameras: Sequence[Camera],
    config: RetrainConfig | None = None,
    progress: Callable[[float], None] | None = None,
) -> GaussianModel:
    """A fresh model that looks like a stolen one, of which only renders from the thief's views are used.

    `progress` is told the part done, 0 to 1. InputError if there is no camera, or the views show nothing to put points
    on.
    """
    return _trainer(marked, cameras, config or RetrainConfig()).run(progress)


def retraining_steps(
    marked: GaussianModel,
    cameras: Sequence[Camera],
    stops: Sequence[int],
    config: RetrainConfig | None = None,
    progress: Callable[[float], None] | None = None,
) -> Iterator[tuple[int, GaussianModel]]:
    """One training, looked at on its way: steps done and the model then, after each of the rising `stops`.

    As `retrain`; the last stop ends the training, whatever number of steps the config has.
    """
    if not stops or list(stops) != sorted(set(stops)) or stops[0] < 1:
        raise InputError(f"stops must be rising positive numbers, got {list(stops)}")
    config = config or RetrainConfig()
    config = replace(config, train=replace(config.train, steps=stops[-1]))
    trainer = _trainer(marked, cameras, config)
    for stop in stops:
        yield stop, trainer.run(progress, until=stop)


def quality_lost(retrained: GaussianModel, stolen: GaussianModel, cameras: Sequence[Camera]) -> dict[str, float]:
    """What the attack cost the thief, on views he did not train on.

    `psnr_to_stolen`: mean PSNR against the stolen model's renders, dB. `lost_db`: how much lower the PSNR of the new
    model against photos is than the stolen one's, where that has 27 dB and the errors are independent.
    """
    values = [
        psnr(np.clip(render(stolen, camera), 0.0, 1.0), np.clip(render(retrained, camera), 0.0, 1.0))
        for camera in cameras
    ]
    mean = float(np.mean(values))
    return {"psnr_to_stolen": mean, "lost_db": 10.0 * float(np.log10(1.0 + 10.0 ** ((PHOTO_DB - mean) / 10.0)))}


def _trainer(marked: GaussianModel, cameras: Sequence[Camera], config: RetrainConfig) -> Trainer:
    if not cameras:
        raise InputError("re-training needs at least one camera")
    rng = np.random.default_rng(config.seed)
    images, points, colors = [], [], []
    share = -(-config.points // len(cameras))
    for camera in cameras:
        image, alpha, depth = render_depth(marked, camera)
        images.append(np.clip(image, 0.0, 1.0))
        places, shades = _lift(images[-1], alpha, depth, camera, share, rng)
        points.append(places)
        colors.append(shades)
    cloud, shade = np.concatenate(points), np.concatenate(colors)
    if len(cloud) < 100:
        raise InputError(f"the {len(cameras)} views show {len(cloud)} points of the model, expected 100 at least")
    if config.start == "random":
        low, high = np.quantile(cloud, [0.02, 0.98], axis=0)
        cloud = rng.uniform(low, high, (config.points, 3))
        shade = rng.uniform(0.0, 1.0, (config.points, 3)).astype(np.float32)
    start = kernels_from_points(cloud, shade, opacity=config.opacity)
    return Trainer(start, cameras, images, config.train)


def _lift(
    image: Float32, alpha: Float32, depth: Float32, camera: Camera, count: int, rng: np.random.Generator
) -> tuple[Float64, Float32]:
    """At most `count` random pixels of a render as points in the world, and their colours."""
    rows, columns = np.nonzero((alpha > LEAST_ALPHA) & (depth > 0))
    chosen = rng.permutation(len(rows))[:count]
    rows, columns = rows[chosen], columns[chosen]
    z = depth[rows, columns].astype(np.float64)
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    local = (pixels @ np.linalg.inv(camera.K).T) * z[:, None]
    points: Float64 = (local - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]
    return points, image[rows, columns]
