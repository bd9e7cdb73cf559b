"""Cameras out of JSON: INRIA's, NeRF's and our own."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from engine.errors import CameraError, InputError
from engine.formats import read_cameras, write_cameras
from engine.model import Camera, Float64
from tests.formats.posed_cameras import assert_close, cameras


def pose_of(camera: Camera) -> Float64:
    """Camera to world, OpenGL's axes."""
    pose: Float64 = np.linalg.inv(camera.viewmat) @ np.diag([1.0, -1.0, -1.0, 1.0])
    return pose


def write_json(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content))
    return path


def test_our_own_file(tmp_path: Path) -> None:
    path = tmp_path / "cameras.json"
    written = write_cameras(cameras(), path)
    assert written == path.stat().st_size
    assert_close(read_cameras(path), cameras())
    assert_close(read_cameras(tmp_path), cameras())


def test_inria_file(tmp_path: Path) -> None:
    """Rotation is camera to world, position the camera's centre; the principal point is in the middle."""
    turn = Rotation.from_euler("xyz", [0.3, -0.5, 1.0]).as_matrix()
    center = np.array([1.0, 2.0, -3.0])
    entry = {"id": 0, "img_name": "a", "width": 640, "height": 480, "fx": 500, "fy": 505.5}
    entry |= {"position": center.tolist(), "rotation": turn.tolist()}
    (camera,) = read_cameras(write_json(tmp_path / "c.json", [entry]))
    ahead = camera.viewmat @ [*(center + turn @ [0, 0, 2]), 1]  # two units before the camera
    np.testing.assert_allclose(ahead, [0, 0, 2, 1], atol=1e-12)
    np.testing.assert_allclose(camera.position, center)
    np.testing.assert_array_equal(camera.K, [[500, 0, 320], [0, 505.5, 240], [0, 0, 1]])


def test_rotations_with_few_decimals_are_made_orthonormal(tmp_path: Path) -> None:
    turn = Rotation.from_euler("xyz", [0.3, -0.5, 1.0]).as_matrix()
    entry = {"width": 64, "height": 48, "fx": 50, "fy": 50, "position": [0, 0, 0], "rotation": turn.round(3).tolist()}
    (camera,) = read_cameras(write_json(tmp_path / "c.json", [entry]))
    R = camera.viewmat[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R, turn.T, atol=2e-3)


def nerf_frame(camera: Camera, pose: np.ndarray | None = None) -> dict[str, Any]:
    """The entry of a camera, of another pose where one is given."""
    intrinsics = {"fl_x": camera.K[0, 0], "fl_y": camera.K[1, 1], "cx": camera.K[0, 2], "cy": camera.K[1, 2]}
    return {"transform_matrix": (pose_of(camera) if pose is None else pose).tolist(), "w": camera.width, **intrinsics}


def test_nerf_file_with_intrinsics(tmp_path: Path) -> None:
    frames = [nerf_frame(camera) | {"file_path": "x"} for camera in cameras()]
    path = write_json(tmp_path / "transforms.json", {"h": 100, "frames": frames})
    assert_close(read_cameras(path), cameras())
    assert_close(read_cameras(tmp_path), cameras())


def test_blender_file_with_an_angle_of_view_takes_the_size_from_the_image(tmp_path: Path) -> None:
    (tmp_path / "train").mkdir()
    Image.new("RGB", (80, 60)).save(tmp_path / "train" / "r_0.png")
    camera = cameras(1)[0]
    frame = {"transform_matrix": pose_of(camera).tolist(), "file_path": "./train/r_0"}
    path = write_json(tmp_path / "transforms_train.json", {"camera_angle_x": 0.7, "frames": [frame]})
    (found,) = read_cameras(path)
    focal = 40 / math.tan(0.35)
    assert_close([found], [Camera(camera.viewmat, np.array([[focal, 0, 40], [0, focal, 30], [0, 0, 1]]), 80, 60)])


@pytest.mark.parametrize("name", ["../secret", "absent", None, 7, "a\0b"])
def test_images_outside_the_folder_are_never_opened(tmp_path: Path, name: Any) -> None:
    Image.new("RGB", (80, 60)).save(tmp_path / "secret.png")
    (tmp_path / "scene").mkdir()
    frame = {"transform_matrix": np.eye(4).tolist(), "file_path": name}
    path = write_json(tmp_path / "scene" / "t.json", {"camera_angle_x": 0.7, "frames": [frame]})
    with pytest.raises(CameraError, match="frame 0: gives no image size"):
        read_cameras(path)
    frame["file_path"] = str(tmp_path / "secret")
    write_json(path, {"camera_angle_x": 0.7, "frames": [frame]})
    with pytest.raises(CameraError, match="frame 0: gives no image size"):
        read_cameras(path)


def test_nerfstudios_transform_is_undone(tmp_path: Path) -> None:
    applied = np.eye(4)
    applied[:3, :3] = 2 * Rotation.from_euler("x", 0.5).as_matrix()
    applied[:3, 3] = [1, -2, 3]
    frames = []
    for camera in cameras():
        moved = applied @ pose_of(camera)
        moved[:3, :3] /= 2  # a pose stays rigid
        frames.append(nerf_frame(camera, moved) | {"h": 100})
    path = write_json(tmp_path / "t.json", {"applied_transform": applied[:3].tolist(), "frames": frames})
    assert_close(read_cameras(path), cameras())


def test_nerfstudios_dataparser_leads_to_the_trained_model(tmp_path: Path) -> None:
    """As its code does it: the transform on poses of the reconstruction, then the scale on their places."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.2, 1.0]).as_matrix()
    turn[:3, 3] = [4, -5, 6]
    scale, frames, wanted = 0.125, [], []
    for camera in cameras():
        frames.append(nerf_frame(camera) | {"h": 100})
        pose = turn @ np.linalg.inv(camera.viewmat)
        pose[:3, 3] *= scale
        wanted.append(Camera(np.linalg.inv(pose), camera.K, camera.width, camera.height))
    path = write_json(tmp_path / "transforms.json", {"frames": frames})
    moved = write_json(tmp_path / "dataparser_transforms.json", {"transform": turn[:3].tolist(), "scale": scale})
    assert_close(read_cameras(path), wanted)
    with pytest.raises(CameraError, match=r"holds no cameras: put it next to the transforms\.json"):
        read_cameras(moved)
    write_json(moved, {"transform": turn[:3].tolist(), "scale": 0})
    with pytest.raises(CameraError, match="are no similarity"):
        read_cameras(path)
    poses = write_json(tmp_path / "transforms_train.json", [{"file_path": "a.jpg", "transform": turn[:3].tolist()}])
    with pytest.raises(CameraError, match="poses without lenses"):
        read_cameras(poses)


GOOD = {"width": 64, "height": 48, "fx": 50, "fy": 50, "position": [0, 0, 0], "rotation": np.eye(3).tolist()}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "camera 1: width 0 is no number of pixels"),
        ({"width": 64.5}, "camera 1: width 64.5 is no number"),
        ({"width": None}, "camera 1: has no 'width'"),
        ({"height": True}, "camera 1: height is no usable number: 'True'"),
        ({"fx": "wide"}, "camera 1: fx is no usable number: 'wide'"),
        ({"fx": float("nan")}, "camera 1: fx is no usable number: 'nan'"),
        ({"fy": 10**400}, "camera 1: fy is no usable number"),
        ({"fy": -5}, "camera 1: focal lengths must be positive"),
        ({"position": [1, 2]}, "camera 1: position is no matrix of 3 finite numbers"),
        ({"position": [1, 2, float("inf")]}, "camera 1: position is no matrix"),
        ({"rotation": [[1, 2], [3]]}, "camera 1: rotation is no matrix of 3 x 3"),
        ({"rotation": np.diag([1, 1, 2]).tolist()}, "camera 1: the rotation is no rotation matrix"),
        ({"rotation": np.diag([1, 1, -1]).tolist()}, "camera 1: the rotation is a reflection"),
        ({"rotation": [["a"] * 3] * 3}, "camera 1: rotation is no matrix"),
    ],
)
def test_faults_of_an_entry_are_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    path = write_json(tmp_path / "bad.json", [GOOD, GOOD | change])
    with pytest.raises(CameraError, match=message) as caught:
        read_cameras(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", r"is no JSON \(line 1\)"),
        ("[" * 100000, "is no JSON"),
        ("[]", "holds no cameras"),
        ("[7]", "camera 0: is no object"),
        ("{}", "is neither a list of cameras"),
        ('{"frames": []}', "holds no frames"),
        ('{"frames": [[]]}', "frame 0: is no object"),
        ('{"frames": [{"w": 8, "h": 8}]}', "frame 0: has no 'camera_angle_x'"),
        ('{"frames": [{"w": 8, "h": 8, "camera_angle_x": 60}]}', "camera_angle_x 60 is no angle of view in radians"),
        ('{"frames": [{"w": 8, "h": 8, "fl_x": 9}]}', "frame 0: has no 'transform_matrix'"),
        (
            '{"frames": [{"camera_model": "EQUIRECTANGULAR"}]}',
            "camera_model 'EQUIRECTANGULAR' is no pinhole and no OPENCV_FISHEYE",
        ),
        ('{"frames": [{}], "applied_transform": [[0,0,0,0],[0,0,0,0],[0,0,0,0]]}', "cannot be undone"),
    ],
)
def test_faults_of_json_files(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(content)
    with pytest.raises(CameraError, match=message):
        read_cameras(path)


def test_paths_that_are_no_cameras(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.json: cannot be read"):
        read_cameras(tmp_path / "absent.json")
    with pytest.raises(CameraError, match="holds no cameras"):
        read_cameras(tmp_path)
    with pytest.raises(InputError, match="is no file name"):
        read_cameras("a\0b")
