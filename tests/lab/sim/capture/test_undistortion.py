"""Undistortion: a picture drawn through a lens by its formula comes back as the pinhole sees it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from engine.errors import CameraError, InputError
from engine.formats.cameras.colmap import PosedPhoto
from engine.lab.sim.capture.photos import read_photo, undistort
from engine.model import Camera

W, H = 160, 120
K = np.array([[150.0, 0, 77.0], [0, 140.0, 63.0], [0, 0, 1]])
NONE = (0.0, 0.0, 0.0, 0.0)


def posed(distortion: tuple[float, float, float, float], name: str = "a.png") -> PosedPhoto:
    return PosedPhoto(name, Camera(np.eye(4), K, W, H), distortion)


def world(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A smooth picture over the directions x/z, y/z."""
    waves = np.stack([np.sin(9 * a + 2 * b), np.cos(7 * b - a), np.sin(5 * (a + b) + 1)], axis=-1)
    return 0.5 + 0.4 * waves


def through_lens(distortion: tuple[float, float, float, float]) -> np.ndarray:
    """What a lens shows: for each pixel, the direction whose distorted image lies there, by fixed point."""
    k1, k2, p1, p2 = distortion
    u, v = np.meshgrid((np.arange(W) + 0.5 - K[0, 2]) / K[0, 0], (np.arange(H) + 0.5 - K[1, 2]) / K[1, 1])
    a, b = u.copy(), v.copy()
    for _ in range(60):
        r2 = a * a + b * b
        radial = 1 + k1 * r2 + k2 * r2 * r2
        a, b = (
            (u - 2 * p1 * a * b - p2 * (r2 + 2 * a * a)) / radial,
            (v - p1 * (r2 + 2 * b * b) - 2 * p2 * a * b) / radial,
        )
    return np.round(255 * world(a, b)).astype(np.uint8)


def seen_by(camera: Camera) -> np.ndarray:
    """What the pinhole shows, by definition."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return world((x - camera.K[0, 2]) / camera.K[0, 0], (y - camera.K[1, 2]) / camera.K[1, 1])


@pytest.mark.parametrize(
    "distortion",
    [(-0.2, 0.0, 0.0, 0.0), (0.3, 0.0, 0.0, 0.0), (-0.1, 0.05, 0.0, 0.0), (0.1, -0.05, 0.01, -0.008)],
    ids=["SIMPLE_RADIAL barrel", "SIMPLE_RADIAL cushion", "RADIAL", "OPENCV"],
)
def test_the_pinhole_picture_comes_back(distortion: tuple[float, float, float, float]) -> None:
    photo = through_lens(distortion)
    untouched = np.abs(photo / 255.0 - seen_by(Camera(np.eye(4), K, W, H))).max()
    camera, image = undistort(photo, posed(distortion))
    error = np.abs(image - seen_by(camera))
    assert error.max() < 0.02
    assert error.mean() < 0.003  # half a pixel of shift would be 0.01
    assert untouched > 0.05
    assert camera.K[0, 0] >= K[0, 0]
    assert camera.K[0, 0] < 1.3 * K[0, 0]


def test_a_pinhole_stays() -> None:
    photo = through_lens(NONE)
    camera, image = undistort(photo, posed(NONE))
    np.testing.assert_allclose(image, photo / 255.0, atol=1e-6)
    np.testing.assert_array_equal(camera.K, K)


@pytest.mark.parametrize("size", [80, 37])
def test_smaller_with_its_camera(size: int) -> None:
    camera, image = undistort(through_lens((-0.2, 0, 0, 0)), posed((-0.2, 0, 0, 0)), size)
    assert image.shape == (camera.height, camera.width, 3)
    assert camera.width == size
    assert np.abs(image - seen_by(camera)).mean() < 0.01


def test_never_larger_than_the_photo() -> None:
    assert undistort(through_lens(NONE), posed(NONE), 999)[0].width == W


def test_a_smaller_copy_of_the_photo_has_a_smaller_camera() -> None:
    photo = through_lens((-0.2, 0, 0, 0))[::2, ::2]
    camera, image = undistort(photo, posed((-0.2, 0, 0, 0)))
    assert camera.K[0, 0] == pytest.approx(K[0, 0] / 2)
    assert image.shape == (60, 80, 3)


def test_too_strong_a_lens() -> None:
    with pytest.raises(CameraError, match=r"a\.png.*too strong"):
        undistort(through_lens(NONE), posed((-40.0, 0.0, 0.0, 0.0)))


def test_reading(tmp_path: Path) -> None:
    photo = through_lens(NONE)
    (tmp_path / "in").mkdir()
    Image.fromarray(photo).save(tmp_path / "in" / "a.png")
    Image.fromarray(photo[:60]).save(tmp_path / "in" / "wide.png")
    np.testing.assert_array_equal(read_photo(tmp_path, posed(NONE, "in/a.png")), photo)
    with pytest.raises(InputError, match="is 160x60, its camera 160x120"):
        read_photo(tmp_path, posed(NONE, "in/wide.png"))
    with pytest.raises(InputError, match="cannot be read"):
        read_photo(tmp_path, posed(NONE, "none.png"))
    with pytest.raises(InputError, match="cannot be read"):
        read_photo(tmp_path, posed(NONE, "in/a\0.png"))
    for name in ("../in/a.png", str(tmp_path / "in" / "a.png")):
        with pytest.raises(InputError, match="lies outside"):
            read_photo(tmp_path / "in" / "deeper", posed(NONE, name))


def test_refused_size() -> None:
    with pytest.raises(InputError, match="size is 0"):
        undistort(through_lens(NONE), posed(NONE), 0)
