"""Fine-tuning a stolen model on pictures: the four settings of the paper's Table 5, and NeRF Signature's before it.

How the table is read here (the paper does not say):

- *Clean images*: renders of the unmarked model, neither rounded nor compressed. No attacker has anything better, for
  the optimum of the loss then lies at the unmarked model itself.
- *No clean images*: the attacker photographs the stolen model, so his pictures carry the mark: renders of the marked
  model as 8-bit files. (Unrounded ones would have no gradient at all.)
- *Pose key*: the pictures are taken at the secret views at which the mark was shaped; without it, from as many views of
  an orbit of the attacker's own.
- *Epoch*: every picture once, in random order. Every parameter moves at INRIA's rates, with a fresh Adam and the
  position rate decaying over the run; densification is off.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.lab.sim.capture.training import TrainConfig, Trainer
from engine.model import Camera, Float32, GaussianModel
from engine.raster import render

__all__ = ["SETTINGS", "FineTuneSetting", "fine_tune", "fine_tune_stages", "pictures_of"]


@dataclass(frozen=True)
class FineTuneSetting:
    """What the attacker has."""

    clean_images: bool  # renders of the unmarked model; otherwise his own of the marked one
    pose_key: bool  # the owner's secret views; otherwise views of his own


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
    told the part done, 0 to 1. InputError if the epochs do not rise, or the pictures do not fit (see `Trainer`).
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
