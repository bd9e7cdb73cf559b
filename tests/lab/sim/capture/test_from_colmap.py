"""From a COLMAP folder to a trained model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.points.reconstruction import read_reconstruction
from engine.lab.sim.capture.capture_kernels import kernels_from_points
from engine.lab.sim.capture.photos import load_photos, train_from_colmap
from engine.lab.sim.capture.trainer import DensifyConfig, TrainConfig
from engine.numerics.image_metrics import psnr
from engine.raster import render
from tests.lab.sim.capture.scenes import orbit, shell, write_colmap

TRUTH = shell()
CONFIG = TrainConfig(steps=150, sh_degree=1, densify=DensifyConfig(first=0.1, every=25, reset=1.0))


def test_train_on_some_and_compare_with_the_rest(tmp_path: Path) -> None:
    cameras = orbit(12)
    images = write_colmap(tmp_path, TRUTH, cameras)
    reports: list[tuple[str, float]] = []
    capture = train_from_colmap(
        tmp_path, images, hold_out=6, config=CONFIG, progress=lambda stage, part: reports.append((stage, part))
    )
    assert [capture.photos.names[k] for k in capture.photos.held_out] == ["p03.png", "p09.png"]
    assert len(capture.psnr) == 12
    assert len(capture.model) > 400
    start = kernels_from_points(*_points(tmp_path))
    untrained = psnr(render(start, cameras[3]), capture.photos.images[3])
    assert capture.psnr[3] > untrained + 5
    assert capture.psnr_held_out == pytest.approx(np.mean([capture.psnr[3], capture.psnr[9]]))
    assert capture.psnr_trained > capture.psnr_held_out > 20
    assert {stage for stage, _ in reports} == {"photos", "train", "compare"}
    assert reports[-1] == ("compare", 1.0)


def _points(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    points = read_reconstruction(folder).points
    return points.positions, points.colors


def test_held_out_photos_are_not_looked_at(tmp_path: Path) -> None:
    """Spoiling them changes no byte of the model."""
    config = replace(CONFIG, steps=20)
    images = write_colmap(tmp_path, TRUTH, orbit(5))
    first = train_from_colmap(tmp_path, images, hold_out=5, config=config).model
    (images / "p02.png").write_bytes((images / "p00.png").read_bytes())
    assert train_from_colmap(tmp_path, images, hold_out=5, config=config).model.sh.tobytes() == first.sh.tobytes()
    (images / "p01.png").write_bytes((images / "p00.png").read_bytes())
    assert train_from_colmap(tmp_path, images, hold_out=5, config=config).model.sh.tobytes() != first.sh.tobytes()


def test_photos_are_undistorted_and_brought_to_size(tmp_path: Path) -> None:
    images = write_colmap(tmp_path, TRUTH, orbit(4), lens="SIMPLE_RADIAL 64 48 64 32 24 0.2")
    photos = load_photos(read_reconstruction(tmp_path), images, size=32, hold_out=0)
    assert photos.held_out == []
    assert photos.trained_on == [0, 1, 2, 3]
    for camera, image in zip(photos.cameras, photos.images, strict=True):
        assert image.shape == (camera.height, camera.width, 3) == (24, 32, 3)
        assert camera.K[0, 0] > 32.5  # 64 halved, and zoomed past the lens's empty corners


@pytest.mark.parametrize(("hold_out", "message"), [(1, "hold_out is 1"), (-1, "hold_out is -1"), (2, "too few")])
def test_refusals(tmp_path: Path, hold_out: int, message: str) -> None:
    images = write_colmap(tmp_path, TRUTH, orbit(2))
    with pytest.raises(InputError, match=message):
        load_photos(read_reconstruction(tmp_path), images, hold_out=hold_out)


def test_a_missing_photo_is_named(tmp_path: Path) -> None:
    images = write_colmap(tmp_path, TRUTH, orbit(4))
    (images / "p01.png").unlink()
    with pytest.raises(InputError, match=r"p01\.png"):
        train_from_colmap(tmp_path, images, hold_out=0)
