"""From photos and their COLMAP reconstruction to a trained Gaussian model."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.errors import InputError
from engine.flows.progress import Clock, Progress
from engine.lab.points.reconstruction import Reconstruction, read_reconstruction
from engine.lab.sim.capture.capture_kernels import kernels_from_points
from engine.lab.sim.capture.training import TrainConfig, Trainer
from engine.lab.sim.capture.undistortion import read_photo, undistort
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render

__all__ = ["Capture", "PhotoSet", "load_photos", "train_from_colmap"]


@dataclass(frozen=True, eq=False)
class PhotoSet:
    """Undistorted photos (H, W, 3), and the numbers of those held out."""

    names: list[str]
    cameras: list[Camera]
    images: list[Float32]
    held_out: list[int]

    @property
    def trained_on(self) -> list[int]:
        """The others."""
        return [k for k in range(len(self.names)) if k not in self.held_out]


@dataclass(frozen=True, eq=False)
class Capture:
    """A model trained on photos.

    The report: numbers of photos, points and Gaussians, steps a second, PSNR of each photo and their means.
    """

    model: GaussianModel
    photos: PhotoSet
    report: dict[str, Any]


def load_photos(
    reconstruction: Reconstruction,
    images: str | os.PathLike[str],
    *,
    size: int = 800,
    hold_out: int = 8,
    clock: Clock | None = None,
) -> PhotoSet:
    """Read the photos of a reconstruction from a folder and undistort them, at most `size` pixels on the longest side.

    By the order of the names, the middle one of every `hold_out` photos is held out, so that it has trained neighbours
    on both sides; 0 holds none out.
    """
    photos = reconstruction.photos
    if hold_out < 0 or hold_out == 1:
        raise InputError(f"hold_out is {hold_out}, expected 0 (none) or at least 2")
    held = [k for k in range(len(photos)) if hold_out and k % hold_out == hold_out // 2]
    if len(photos) - len(held) < 2:
        raise InputError(f"{len(photos)} photos, {len(held)} of them held out, are too few to train on")
    cameras, pictures = [], []
    for k, photo in enumerate(photos):
        camera, picture = undistort(read_photo(images, photo), photo, size)
        cameras.append(camera)
        pictures.append(picture)
        if clock is not None:
            clock.advance((k + 1) / len(photos))
    return PhotoSet([photo.name for photo in photos], cameras, pictures, held)


def train_from_colmap(
    folder: str | os.PathLike[str],
    images: str | os.PathLike[str],
    *,
    size: int = 800,
    hold_out: int = 8,
    config: TrainConfig | None = None,
    progress: Progress | None = None,
) -> Capture:
    """Train a model on the photos of a COLMAP model in a folder, see `read_reconstruction` and `load_photos`.

    Progress has the stages "photos", "train" and "compare".
    """
    config = config or TrainConfig()
    clock = Clock(progress)
    reconstruction = read_reconstruction(folder)
    with clock.stage("photos"):
        photos = load_photos(reconstruction, images, size=size, hold_out=hold_out, clock=clock)
    start = kernels_from_points(reconstruction.points.positions, reconstruction.points.colors)
    used = photos.trained_on
    trainer = Trainer(start, [photos.cameras[k] for k in used], [photos.images[k] for k in used], config)
    with clock.stage("train"):
        model = trainer.run(clock.advance)
    with clock.stage("compare"):
        quality = photo_quality(model, photos, config.background)
    report = {
        "photos": len(photos.names),
        "points": len(reconstruction.points),
        "gaussians": len(model),
        "steps": config.steps,
        "steps_per_second": config.steps / clock.seconds["train"],
        **quality,
        "seconds_by_stage": clock.seconds,
    }
    return Capture(model, photos, report)


def photo_quality(model: GaussianModel, photos: PhotoSet, background: Any = 0.0) -> dict[str, Any]:
    """PSNR of the renders against the photos, dB: each, and the means over those trained on and held out.

    A random background counts as black.
    """
    behind = 0.0 if isinstance(background, str) else background
    pairs = zip(photos.cameras, photos.images, strict=True)
    values = [psnr(render(model, camera, behind), image) for camera, image in pairs]

    def mean(which: Sequence[int]) -> float | None:
        return float(np.mean([values[k] for k in which])) if which else None

    return {
        "psnr_trained": mean(photos.trained_on),
        "psnr_held_out": mean(photos.held_out),
        "held_out": [photos.names[k] for k in photos.held_out],
        "psnr": dict(zip(photos.names, values, strict=True)),
    }
