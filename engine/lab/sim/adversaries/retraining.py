"""Training against the mark: fine-tuning a stolen model on pictures, or training a fresh one on its renders.

How the paper's Table 5 (and NeRF Signature's before it) is read here, since the paper does not say:

- *Clean images*: renders of the unmarked model, neither rounded nor compressed. No attacker has anything better, for
  the optimum of the loss then lies at the unmarked model itself.
- *No clean images*: the attacker photographs the stolen model, so the pictures carry the mark: renders of the marked
  model as 8-bit files. (Unrounded ones would have no gradient at all.)
- *Pose key*: the pictures are taken at the secret views at which the mark was shaped; without it, from as many views of
  an orbit of the attacker's own.
- *Epoch*: every picture once, in random order. Every parameter moves at INRIA's rates, with a fresh Adam and the
  position rate decaying over the run; densification is off.

A fresh model keeps none of the stolen Gaussians, only the look: 1. render the stolen model from views of the attacker's
choice; 2. lift points from the depths of these renders, and make round Gaussians of them;
3. train all parameters on the renders, as on photos. No published result says whether a mark survives that.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.lab.sim.capture.capture_kernels import kernels_from_points
from engine.lab.sim.capture.trainer import TrainConfig, Trainer
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render, render_depth


@dataclass(frozen=True)
class FineTuneSetting:
    """What the attacker has."""

    clean_images: bool  # renders of the unmarked model; otherwise own renders of the marked one
    pose_key: bool  # the owner's secret views; otherwise own views


SETTINGS: dict[str, FineTuneSetting] = {
    "key": FineTuneSetting(False, True),
    "neither": FineTuneSetting(False, False),
    "clean+key": FineTuneSetting(True, True),
    "clean": FineTuneSetting(True, False),
}
"""In the order of the paper's table."""


def pictures_of(
    setting: FineTuneSetting,
    original: GaussianModel,
    marked: GaussianModel,
    key_views: Sequence[Camera],
    *,
    size: int = 400,
    seed: int = 0,
) -> tuple[list[Camera], list[Float32]]:
    """The views and pictures (size, size, 3), 0 to 1, that an attacker trains on.

    Without the pose key only the number of the owner's `key_views` is used, and `seed` draws the attacker's own.
    """
    if setting.pose_key:
        cameras = [camera.resized(size, size) for camera in key_views]
    else:
        jitter = np.random.default_rng((seed, 5)).uniform(size=(len(key_views), 4))
        cameras = make_rig(marked, len(key_views), size, size, jitter=jitter)
    shown = original if setting.clean_images else marked
    images = [np.clip(render(shown, camera), 0.0, 1.0) for camera in cameras]
    if not setting.clean_images:
        images = [(np.round(image * 255.0) / 255.0).astype(np.float32) for image in images]
    return cameras, images


def fine_tune_stages(
    model: GaussianModel,
    cameras: Sequence[Camera],
    images: Sequence[Float32],
    epochs: Sequence[int],
    *,
    trained: Literal["all", "colors"] = "all",
    seed: int = 0,
    advance: Callable[[float], None] | None = None,
) -> Iterator[tuple[int, GaussianModel]]:
    """One training of the stolen model, looked at after several numbers of epochs: pairs of epoch and model.

    Cameras and images are those of `pictures_of`. The epochs rise, the last one more than 0; 0 is the model as it is.
    `trained` is every parameter, or SH alone with the geometry frozen; `seed` that of the pictures' order; `advance` is
    called with the part done, 0 to 1. InputError if the epochs do not rise, or the pictures do not fit (see `Trainer`).
    """
    if not epochs or epochs[0] < 0 or epochs[-1] < 1 or any(np.diff(epochs) <= 0):
        raise InputError(f"epochs must rise and end above 0, got {list(epochs)}")
    config = TrainConfig(
        steps=epochs[-1] * max(len(cameras), 1), trained=trained, sh_degree=None, densify=None, seed=seed
    )
    trainer = Trainer(model, cameras, images, config)
    for epoch in epochs:
        yield epoch, trainer.run(advance, epoch * len(cameras)) if epoch else model


def fine_tune(
    model: GaussianModel,
    cameras: Sequence[Camera],
    images: Sequence[Float32],
    epochs: int,
    *,
    trained: Literal["all", "colors"] = "all",
    seed: int = 0,
    advance: Callable[[float], None] | None = None,
) -> GaussianModel:
    """A model after so many epochs on pictures; parameters and errors as for `fine_tune_stages`."""
    stages = fine_tune_stages(model, cameras, images, [epochs], trained=trained, seed=seed, advance=advance)
    return next(stages)[1]


START_OPACITY = 0.5  # of every Gaussian of a fresh model
LEAST_ALPHA = 0.5  # a pixel this opaque shows a surface, on which a point may lie
PHOTO_DB = 27.0
"""What a trained model usually reaches on photos it has not seen (27.2 dB, Mip-NeRF 360 scenes, Kerbl et al. 2023)."""


@dataclass(frozen=True)
class RetrainConfig:
    """Knobs of the attack."""

    points: int = 50_000  # Gaussians to start from
    # of the training; `train.steps` renders are shown
    train: TrainConfig = field(
        default_factory=lambda: TrainConfig(steps=3_000, sh_degree=0, densify=None, opacity_rate=0.02)
    )
    seed: int = 0  # of the points chosen

    def __post_init__(self) -> None:
        if self.points < 100:
            raise InputError(f"points is {self.points}, expected at least 100")


def retrain(
    marked: GaussianModel,
    cameras: Sequence[Camera],
    config: RetrainConfig | None = None,
    progress: Callable[[float], None] | None = None,
) -> GaussianModel:
    """A fresh model that looks like a stolen one, from renders of the attacker's views alone.

    `progress` is called with the part done, 0 to 1. InputError if there is no camera, or the views show too little.
    """
    return _trainer(marked, cameras, config or RetrainConfig()).run(progress)


def quality_lost(retrained: GaussianModel, stolen: GaussianModel, cameras: Sequence[Camera]) -> dict[str, float]:
    """The quality that the attack lost, on views that were not trained on.

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
    start = kernels_from_points(cloud, shade, opacity=START_OPACITY)
    return Trainer(start, cameras, images, config.train)


def _lift(
    image: Float32, alpha: Float32, depth: Float32, camera: Camera, count: int, rng: np.random.Generator
) -> tuple[Float64, Float32]:
    """At most `count` random pixels of a render as points in the world, and their colors."""
    rows, columns = np.nonzero((alpha > LEAST_ALPHA) & (depth > 0))
    chosen = rng.permutation(len(rows))[:count]
    rows, columns = rows[chosen], columns[chosen]
    z = depth[rows, columns].astype(np.float64)
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    local = (pixels @ np.linalg.inv(camera.K).T) * z[:, None]
    points: Float64 = (local - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]
    return points, image[rows, columns]
