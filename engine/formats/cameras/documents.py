"""Cameras out of JSON: INRIA's cameras.json (a list) and NeRF's transforms.json (an object with frames)."""

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from engine.errors import CameraError
from engine.formats.cameras.fisheye import FisheyeCamera
from engine.model import Camera, Float64
from engine.numerics.plain import Json

MAX_IMAGE_SIDE = 1 << 16
"""Pixels; a larger side is a mistake."""

_ROTATION_TOLERANCE = 1e-2  # files with few decimals are accepted and made orthonormal
_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
DATAPARSER = "dataparser_transforms.json"
"""How nerfstudio moved a scene before it trained: the frame of what ns-export writes."""
_FISHEYE = "OPENCV_FISHEYE"
_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")


def read_inria(entries: list[Any], file: str) -> list[Camera]:
    """Cameras of a parsed cameras.json; without cx, cy the principal point is the centre of the image."""
    if not entries:
        raise CameraError(f"{file}: holds no cameras")
    cameras = []
    for k, entry in enumerate(entries):
        where = f"{file}: camera {k}"
        if not isinstance(entry, dict):
            raise CameraError(f"{where}: is no object")
        width, height = _size(entry, "width", where), _size(entry, "height", where)
        rotation = _matrix(entry, "rotation", (3, 3), where)
        position = _matrix(entry, "position", (3,), where)
        K = _intrinsics(
            _number(entry, "fx", where),
            _number(entry, "fy", where),
            _number(entry, "cx", where, width / 2),
            _number(entry, "cy", where, height / 2),
        )
        cameras.append(make_camera(rotation, position, K, width, height, where))
    return cameras


def read_nerf(content: Json, file: str, folder: Path, moved: Json | None = None) -> list[Camera]:
    """Cameras of a parsed transforms.json; images in `folder` are looked at only where no size is given. `moved`, a
    parsed dataparser_transforms.json, brings them from the reconstruction's frame to that of the trained model."""
    frames = content["frames"]
    if not frames:
        raise CameraError(f"{file}: holds no frames")
    undo: Float64 = np.eye(4)
    if content.get("applied_transform") is not None:
        undo[:3] = _matrix(content, "applied_transform", (3, 4), file)
        if abs(np.linalg.det(undo[:3, :3])) < 1e-9:
            raise CameraError(f"{file}: applied_transform cannot be undone")
        undo = np.asarray(np.linalg.inv(undo), dtype=np.float64)
    to_model: Float64 = np.eye(4)
    if moved is not None:
        to_model[:3] = _matrix(moved, "transform", (3, 4), DATAPARSER)
        to_model[:3] *= _number(moved, "scale", DATAPARSER)
        if abs(np.linalg.det(to_model[:3, :3])) < 1e-30:
            raise CameraError(f"{DATAPARSER}: transform and scale are no similarity")
    undo = to_model @ undo
    cameras, distorted = [], 0
    for k, frame in enumerate(frames):
        where = f"{file}: frame {k}"
        if not isinstance(frame, dict):
            raise CameraError(f"{where}: is no object")
        entry = {**content, **frame}  # a frame's own intrinsics come first
        model = _FISHEYE if entry.get("is_fisheye") is True else entry.get("camera_model", "OPENCV")  # instant-ngp's
        if model not in (*_PINHOLES, _FISHEYE):
            message = f"camera_model {str(model)[:40]!r} is no pinhole and no {_FISHEYE}: leave --cameras out, and"
            raise CameraError(f"{where}: {message} cameras of pictures are found")
        if "w" not in entry or "h" not in entry:
            entry["w"], entry["h"] = _image_size(entry.get("file_path"), folder, where)
        width, height = _size(entry, "w", where), _size(entry, "h", where)
        fx = _focal(entry, "fl_x", "camera_angle_x", width, where)
        fy = _focal(entry, "fl_y", "camera_angle_y", height, where, fx)
        K = _intrinsics(fx, fy, _number(entry, "cx", where, width / 2), _number(entry, "cy", where, height / 2))
        rows = entry.get("transform_matrix")
        if isinstance(rows, list) and len(rows) == 3:  # without the last row, which is always the same
            entry["transform_matrix"] = [*rows, [0, 0, 0, 1]]
        pose = _matrix(entry, "transform_matrix", (4, 4), where)
        distortion = {key: _number(entry, key, where, 0.0) for key in _DISTORTION}
        bends = tuple(distortion[f"k{k}"] for k in (1, 2, 3, 4)) if model == _FISHEYE else None
        distorted += bends is None and any(distortion.values())
        pose = undo @ pose
        scale = abs(np.linalg.det(undo[:3, :3])) ** (1 / 3)  # an applied scale moves cameras, turns none
        pose[:3, :3] /= scale
        pose = pose @ _OPENGL_TO_OPENCV
        cameras.append(make_camera(pose[:3, :3], pose[:3, 3], K, width, height, where, bends))
    if distorted:
        warn_of_distortion(file, distorted)
    return cameras


def make_camera(
    rotation: Float64,
    position: Float64,
    K: Float64,
    width: int,
    height: int,
    where: str,
    bends: tuple[float, ...] | None = None,
) -> Camera:
    """A camera from its pose in the world: rotation (3, 3) camera to world, position (3,) of its centre; with `bends`
    (4,) a fisheye."""
    if not np.abs(rotation.T @ rotation - np.eye(3)).max() <= _ROTATION_TOLERANCE:
        raise CameraError(f"{where}: the rotation is no rotation matrix")
    if np.linalg.det(rotation) < 0:
        raise CameraError(f"{where}: the rotation is a reflection")
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-12:
        u, _, v = np.linalg.svd(rotation)
        rotation = u @ v  # the nearest rotation
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation.T, -rotation.T @ position
    try:
        if bends is not None:
            return FisheyeCamera(viewmat, K, width, height, bends)  # type: ignore[arg-type]
        return Camera(viewmat, K, width, height)
    except CameraError as error:
        raise CameraError(f"{where}: {error}") from None


def warn_of_distortion(file: str, count: int) -> None:
    """Say that lens distortion is ignored."""
    message = f"{file}: the lens distortion of {count} cameras is ignored; undistorted images would match better"
    warnings.warn(message, UserWarning, stacklevel=5)


def _intrinsics(fx: float, fy: float, cx: float, cy: float) -> Float64:
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _focal(entry: Json, key: str, angle_key: str, side: int, where: str, default: float | None = None) -> float:
    """Focal length in pixels, given as such or by the angle of view (radians)."""
    if entry.get(key) is not None:
        return _number(entry, key, where)
    if entry.get(angle_key) is None and default is not None:
        return default
    angle = _number(entry, angle_key, where)
    if not 0 < angle < math.pi:
        raise CameraError(f"{where}: {angle_key} {angle:g} is no angle of view in radians")
    return side / 2 / math.tan(angle / 2)


def _number(entry: Json, key: str, where: str, default: float | None = None) -> float:
    value = entry.get(key)
    if value is None and default is not None:
        return default
    if value is None:
        raise CameraError(f"{where}: has no {key!r}")
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e15:
        raise CameraError(f"{where}: {key} is no usable number: {str(value)[:40]!r}")
    return float(value)


def _size(entry: Json, key: str, where: str) -> int:
    value = _number(entry, key, where)
    if value != int(value) or not 1 <= value <= MAX_IMAGE_SIDE:
        raise CameraError(f"{where}: {key} {value:g} is no number of pixels from 1 to {MAX_IMAGE_SIDE}")
    return int(value)


def _matrix(entry: Json, key: str, shape: tuple[int, ...], where: str) -> Float64:
    value = entry.get(key)
    if value is None:
        raise CameraError(f"{where}: has no {key!r}")
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape != shape or not (np.abs(matrix) < 1e15).all():
        size = " x ".join(str(n) for n in shape)
        raise CameraError(f"{where}: {key} is no matrix of {size} finite numbers")
    return matrix


def _image_size(name: Any, folder: Path, where: str) -> tuple[int, int]:
    """Size of a frame's image, which must lie below the folder: a camera file is no way to other files."""
    from PIL import Image, UnidentifiedImageError

    if isinstance(name, str) and "\0" not in name and len(name) < 1000:
        root = folder.resolve()
        for suffix in ("", ".png", ".jpg"):
            path = (root / (name + suffix)).resolve()
            if path.is_relative_to(root) and path.is_file():
                try:
                    with Image.open(path) as image:
                        return image.size
                except (OSError, UnidentifiedImageError, Image.DecompressionBombError):
                    continue
    raise CameraError(f"{where}: gives no image size (w, h), and its image is not there to tell")
