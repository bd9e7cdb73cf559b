"""Cameras out of COLMAP models, text and binary."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from engine.errors import CameraError, Mark3DGSError
from engine.formats import read_cameras
from engine.model import Camera
from tests.formats.posed_cameras import assert_close, cameras


def colmap_text(folder: Path, model: str, parameters: str) -> Path:
    folder.mkdir(parents=True)
    (folder / "cameras.txt").write_text(f"# comment\n7 {model} 200 100 {parameters}\n")
    lines = ["# comment"]
    for k, camera in reversed(list(enumerate(cameras()))):
        x, y, z, w = Rotation.from_matrix(camera.viewmat[:3, :3]).as_quat()
        numbers = " ".join(repr(float(v)) for v in (w, x, y, z, *camera.viewmat[:3, 3]))
        lines += [f"{9 - k} {numbers} 7 image {k}.jpg", "1.5 2.5 -1" if k else ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    return folder


def colmap_binary(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 7, 1, 200, 100, 300, 310.5, 90.25, 50))
    content = struct.pack("<Q", 3)
    for k, camera in reversed(list(enumerate(cameras()))):
        x, y, z, w = Rotation.from_matrix(camera.viewmat[:3, :3]).as_quat()
        content += struct.pack("<i7di", 9 - k, w, x, y, z, *camera.viewmat[:3, 3], 7)
        content += f"image {k}.jpg".encode() + b"\0" + struct.pack("<Q", k) + struct.pack("<ddq", 1, 2, 3) * k
    (folder / "images.bin").write_bytes(content)
    return folder


def posed(fx: float, fy: float) -> list[Camera]:
    """The cameras with one size and lens."""
    K = np.array([[fx, 0, 90.25], [0, fy, 50], [0, 0, 1]])
    return [Camera(camera.viewmat, K, 200, 100) for camera in cameras()]


@pytest.mark.parametrize(
    ("model", "parameters", "fy"),
    [
        ("SIMPLE_PINHOLE", "300 90.25 50", 300),
        ("PINHOLE", "300 310.5 90.25 50", 310.5),
        ("SIMPLE_RADIAL", "300 90.25 50 0", 300),
        ("RADIAL", "300 90.25 50 0 0", 300),
        ("OPENCV", "300 310.5 90.25 50 0 0 0 0", 310.5),
    ],
)
def test_colmap_text_by_name_of_image(tmp_path: Path, model: str, parameters: str, fy: float) -> None:
    folder = colmap_text(tmp_path / "sparse" / "0", model, parameters)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path in (folder, folder / "cameras.txt", folder / "images.txt", tmp_path):
            assert_close(read_cameras(path), posed(300, fy))
    for name in ("cameras.txt", "images.txt"):  # as editors of Windows save them
        (folder / name).write_bytes(b"\xef\xbb\xbf" + (folder / name).read_bytes())
    assert_close(read_cameras(folder), posed(300, fy))


def test_colmap_binary(tmp_path: Path) -> None:
    folder = colmap_binary(tmp_path / "model")
    for path in (folder, folder / "cameras.bin", folder / "images.bin"):
        assert_close(read_cameras(path), posed(300, 310.5))


@pytest.mark.parametrize(
    ("model", "parameters"),
    [("SIMPLE_RADIAL", "300 90.25 50 0.1"), ("OPENCV", "300 300 90.25 50 0 0 0 0.001"), ("RADIAL", "300 90.25 50 0 1")],
)
def test_distortion_is_ignored_with_a_warning(tmp_path: Path, model: str, parameters: str) -> None:
    folder = colmap_text(tmp_path / "model", model, parameters)
    with pytest.warns(UserWarning, match=r"cameras\.txt: the lens distortion of 3 cameras is ignored"):
        assert_close(read_cameras(folder), posed(300, 300))


@pytest.mark.parametrize(
    ("cameras_txt", "images_txt", "message"),
    [
        ("7 FISHEYE 200 100 1 2 3", None, r"cameras\.txt: line 1: camera model 'FISHEYE' is not read here"),
        ("7 PINHOLE 200 100 1 2 3", None, r"cameras\.txt: line 1: PINHOLE has 4 parameters, not 3"),
        ("7 PINHOLE 0 100 1 2 3 4", None, "0 x 100 is no image size"),
        ("7 PINHOLE 200 100 1 nan 3 4", None, "are no focal length and principal point"),
        ("7 PINHOLE 200", None, r"cameras\.txt: line 1: is no camera"),
        ("8 PINHOLE 200 100 1 2 3 4", None, r"images\.txt: line 6 \(image 0.jpg\): camera 7 is not in"),
        (None, "", r"images\.txt: holds no images"),
        (None, "1 0 0 0 0 0 0 0 7 a.jpg", r"images\.txt: line 1 \(a\.jpg\): the pose is no rotation"),
        (None, "1 1 0 0 0 inf 0 0 7 a.jpg", "the pose is no rotation and translation"),
        (None, "1 1 0 0 0", r"images\.txt: line 1: is no image"),
    ],
)
def test_faults_of_colmap_text(tmp_path: Path, cameras_txt: str | None, images_txt: str | None, message: str) -> None:
    folder = colmap_text(tmp_path / "model", "PINHOLE", "300 310.5 90.25 50")
    for name, text in (("cameras.txt", cameras_txt), ("images.txt", images_txt)):
        if text is not None:
            (folder / name).write_text(text)
    with pytest.raises(CameraError, match=message):
        read_cameras(folder)


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_broken_colmap_binary(tmp_path: Path, data: st.DataObject) -> None:
    """Cut off and overwritten anywhere, counts included: an error of ours, or cameras."""
    folder = tmp_path / "model"
    if not folder.exists():
        colmap_binary(folder)
        for name in ("cameras", "images"):
            (folder / f"{name}.bin").rename(tmp_path / name)
    for name in ("cameras", "images"):
        content = bytearray((tmp_path / name).read_bytes())
        at = data.draw(st.integers(0, len(content) - 1))
        if data.draw(st.booleans()):
            del content[at:]
        else:
            content[at : at + 8] = data.draw(st.binary(min_size=8, max_size=8))
        (folder / f"{name}.bin").write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            found = len(read_cameras(folder))
        except Mark3DGSError as error:
            found = len(str(error))
    assert found > 0
