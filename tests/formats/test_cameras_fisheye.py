"""Fisheye cameras of nerfstudio and COLMAP: their pictures become those of a pinhole at the same place."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from engine.errors import CameraError
from engine.flows.verify.search import Suspect
from engine.formats import read_cameras
from engine.formats.cameras.fisheye import FisheyeCamera
from engine.model import Camera, Float32, Float64
from tests.formats.posed_cameras import cameras
from tests.formats.test_cameras import pose_of
from tests.formats.test_cameras_colmap import colmap_text

BENDS = (-0.03, 0.008, -0.002, 0.0005)
WIDTH, HEIGHT, FOCAL = 160, 120, 70.0
CENTER = (79.25, 61.0)


def seen(directions: Float64) -> Float32:
    """(H, W, 3) what lies in directions (H, W, 3): a pattern without edges."""
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return (0.5 + 0.5 * np.sin(7 * unit + [0, 1, 2])).astype(np.float32)


def plane() -> tuple[Float64, Float64]:
    """Of every pixel's center, its place on the picture plane in units of the focal length."""
    v, u = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return (u - CENTER[0]) / FOCAL, (v - CENTER[1]) / FOCAL


def through_the_fisheye() -> Float32:
    """The lens's formula solved pixel by pixel: which angle ends at this radius."""
    a, b = plane()
    radius = np.hypot(a, b)
    knots = np.linspace(0, radius.max(), 400)

    def off(t: float, at: float) -> float:
        return float(t * (1 + sum(k * t ** (2 * n) for n, k in enumerate(BENDS, 1))) - at)

    angles = np.interp(radius, knots, [brentq(off, 0, 2.5, args=(r,)) for r in knots])
    across = np.where(radius > 0, np.sin(angles) / np.maximum(radius, 1e-12), 1.0)
    return seen(np.stack([a * across, b * across, np.cos(angles)], axis=-1))


def through_a_pinhole() -> Float32:
    a, b = plane()
    return seen(np.stack([a, b, np.ones_like(a)], axis=-1))


def nerfstudio(folder: Path, **changes: object) -> Path:
    k = {f"k{n}": bend for n, bend in enumerate(BENDS, 1)}
    lens = {"fl_x": FOCAL, "fl_y": FOCAL, "cx": CENTER[0], "cy": CENTER[1], "w": WIDTH, "h": HEIGHT}
    frames = [{"transform_matrix": pose_of(camera).tolist()} for camera in cameras()]
    content = {"camera_model": "OPENCV_FISHEYE", "frames": frames, **lens, **k, **changes}
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder / "transforms.json"


def test_a_picture_is_brought_to_the_pinhole(tmp_path: Path) -> None:
    known = read_cameras(nerfstudio(tmp_path))
    assert all(isinstance(camera, FisheyeCamera) and camera.bends == BENDS for camera in known)
    suspect = Suspect(None, [through_the_fisheye()] * len(known), known)
    assert suspect.cameras is not None
    for picture, camera, before in zip(suspect.pictures, suspect.cameras, known, strict=True):
        np.testing.assert_allclose(picture[2:-2, 2:-2], through_a_pinhole()[2:-2, 2:-2], atol=0.01)
        assert type(camera) is Camera
        np.testing.assert_array_equal(camera.viewmat, before.viewmat)
    assert np.abs(through_the_fisheye() - through_a_pinhole()).max() > 0.3, "or there would be nothing to undo"


def test_a_smaller_copy_of_the_picture(tmp_path: Path) -> None:
    (camera, *_) = read_cameras(nerfstudio(tmp_path))
    half = through_the_fisheye().reshape(HEIGHT // 2, 2, WIDTH // 2, 2, 3).mean(axis=(1, 3))
    assert isinstance(camera, FisheyeCamera)
    picture, pinhole = camera.undistort(half)
    wanted = through_a_pinhole().reshape(HEIGHT // 2, 2, WIDTH // 2, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(picture[2:-2, 2:-2], wanted[2:-2, 2:-2], atol=0.02)
    assert (pinhole.width, pinhole.K[0, 2]) == (WIDTH // 2, CENTER[0] / 2)


@pytest.mark.parametrize(
    ("model", "parameters", "bends"),
    [
        ("OPENCV_FISHEYE", "80 81 100 50 0.1 0.01 0.001 0.0001", (0.1, 0.01, 0.001, 0.0001)),
        ("SIMPLE_RADIAL_FISHEYE", "80 100 50 0.1", (0.1, 0, 0, 0)),
        ("RADIAL_FISHEYE", "80 100 50 0.1 0.01", (0.1, 0.01, 0, 0)),
    ],
)
def test_colmaps_fisheyes(tmp_path: Path, model: str, parameters: str, bends: tuple[float, ...]) -> None:
    for camera in read_cameras(colmap_text(tmp_path / "model", model, parameters)):
        assert isinstance(camera, FisheyeCamera)
        assert camera.bends == bends


def test_what_bends_back_and_what_is_no_fisheye_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match=r"frame 0: the fisheye .* bends back"):
        read_cameras(nerfstudio(tmp_path, k1=-0.6))
    with pytest.raises(CameraError, match=r"EQUIRECTANGULAR.*leave --cameras out"):
        read_cameras(nerfstudio(tmp_path, camera_model="EQUIRECTANGULAR"))
