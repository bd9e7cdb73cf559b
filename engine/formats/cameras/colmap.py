"""Cameras out of a COLMAP model, text or binary (https://colmap.github.io/format.html)."""

import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.errors import CameraError
from engine.formats.cameras.documents import MAX_IMAGE_SIDE, make_camera, warn_of_distortion
from engine.model import Camera, Float64
from engine.numerics.similarity import quaternion_to_rotation

_LENSES = {  # of COLMAP: the number in binary files, parameters, and how many of them are focals
    "SIMPLE_PINHOLE": (0, 3, 1),
    "PINHOLE": (1, 4, 2),
    "SIMPLE_RADIAL": (2, 4, 1),
    "RADIAL": (3, 5, 1),
    "OPENCV": (4, 8, 2),
    "OPENCV_FISHEYE": (5, 8, 2),
    "SIMPLE_RADIAL_FISHEYE": (8, 4, 1),
    "RADIAL_FISHEYE": (9, 5, 1),
}
_STRAIGHT = (0.0, 0.0, 0.0, 0.0)
_LARGEST = 1e15  # in pixels and scene units; also false for what is no number
_NAMES = {number: name for name, (number, _, _) in _LENSES.items()}


@dataclass(frozen=True, eq=False)
class PosedPhoto:
    """A photo of a reconstruction: where it was taken from, and through which lens.

    `name` is the file's, as the reconstruction gives it; it may hold folders and is not to be trusted as a path.
    `camera` is the lens without its distortion, which is OpenCV's k1, k2, p1, p2; zeros for a pinhole. Or it is a
    `FisheyeCamera`, which has its own.
    """

    name: str
    camera: Camera
    distortion: tuple[float, float, float, float]


@dataclass(frozen=True)
class _Intrinsics:
    K: Float64
    width: int
    height: int
    distortion: tuple[float, float, float, float]
    fisheye: bool


@dataclass(frozen=True)
class _Image:
    name: str
    quat: tuple[float, ...]
    t: tuple[float, ...]
    camera: int
    where: str


def read_colmap(cameras: bytes, images: bytes, cameras_file: str, images_file: str, *, binary: bool) -> list[Camera]:
    """As `read_photos`, cameras only; says so where it ignores lens distortion."""
    photos = read_photos(cameras, images, cameras_file, images_file, binary=binary)
    distorted = sum(any(photo.distortion) for photo in photos)
    if distorted:
        warn_of_distortion(cameras_file, distorted)
    return [photo.camera for photo in photos]


def read_photos(
    cameras: bytes, images: bytes, cameras_file: str, images_file: str, *, binary: bool
) -> list[PosedPhoto]:
    """All images with their cameras and distortion, in the order of their names, out of the content of the two files.

    CameraError if they are broken, or a camera model is no pinhole with mild distortion and no fisheye of OpenCV's.
    """
    lenses = (_binary_cameras if binary else _text_cameras)(cameras, cameras_file)
    posed = (_binary_images if binary else _text_images)(images, images_file)
    if not posed:
        raise CameraError(f"{images_file}: holds no images")
    result = []
    for image in sorted(posed, key=lambda image: image.name):
        lens = lenses.get(image.camera)
        if lens is None:
            raise CameraError(f"{image.where}: camera {image.camera} is not in {cameras_file}")
        norm = math.hypot(*image.quat)
        if not (0.5 < norm < 2.0 and all(abs(value) < _LARGEST for value in image.t)):
            raise CameraError(f"{image.where}: the pose is no rotation and translation")
        to_camera = quaternion_to_rotation(np.array(image.quat) / norm).reshape(3, 3)  # (3, 3)
        position = -to_camera.T @ np.array(image.t)
        bends = lens.distortion if lens.fisheye else None
        camera = make_camera(to_camera.T, position, lens.K, lens.width, lens.height, image.where, bends)
        result.append(PosedPhoto(image.name, camera, _STRAIGHT if lens.fisheye else lens.distortion))
    return result


def _intrinsics(model: str, width: int, height: int, parameters: list[float], where: str) -> _Intrinsics:
    lens = _LENSES.get(model)
    if lens is None:
        message = f"camera model {model[:40]!r} is not read here, only {', '.join(_LENSES)}; undistort the images"
        raise CameraError(f"{where}: {message}")
    _, wanted, focals = lens
    if len(parameters) != wanted:
        raise CameraError(f"{where}: {model} has {wanted} parameters, not {len(parameters)}")
    if not (1 <= width <= MAX_IMAGE_SIDE and 1 <= height <= MAX_IMAGE_SIDE):
        raise CameraError(f"{where}: {width} x {height} is no image size")
    fx, fy = parameters[0], parameters[focals - 1]
    cx, cy = parameters[focals : focals + 2]
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if not (all(abs(value) < _LARGEST for value in parameters) and fx > 0 and fy > 0):
        raise CameraError(f"{where}: the parameters are no focal length and principal point")
    k1, k2, p1, p2 = (*parameters[focals + 2 :], 0.0, 0.0, 0.0, 0.0)[:4]
    return _Intrinsics(K, width, height, (k1, k2, p1, p2), model.endswith("FISHEYE"))


def _text_cameras(data: bytes, file: str) -> dict[int, _Intrinsics]:
    cameras = {}
    for number, line in enumerate(data.decode("utf-8-sig", "replace").splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        where = f"{file}: line {number}"
        try:
            key, width, height = int(words[0]), int(words[2]), int(words[3])
            parameters = [float(word) for word in words[4:]]
        except (ValueError, IndexError):
            raise CameraError(f"{where}: is no camera (id, model, width, height, parameters)") from None
        cameras[key] = _intrinsics(words[1], width, height, parameters, where)
    return cameras


def _text_images(data: bytes, file: str) -> list[_Image]:
    """Every image has two lines, the second of which lists points and may be empty."""
    images, points_follow = [], False
    for number, line in enumerate(data.decode("utf-8-sig", "replace").splitlines(), 1):
        if line.startswith("#"):
            continue
        # Some programs leave the lines of points out; those end with a point's number, an image with its name.
        last = line[-40:].split()[-1:]
        if not last or (points_follow and last[0].lstrip("-").isdigit()):
            points_follow = False
            continue
        words = line.split(maxsplit=9)
        where = f"{file}: line {number}"
        try:
            quat, t = tuple(float(w) for w in words[1:5]), tuple(float(w) for w in words[5:8])
            images.append(_Image(words[9].strip(), quat, t, int(words[8]), f"{where} ({words[9].strip()[:80]})"))
        except (ValueError, IndexError):
            raise CameraError(f"{where}: is no image (id, qw, qx, qy, qz, tx, ty, tz, camera, name)") from None
        points_follow = True
    return images


class _Reader:
    """Takes values from a binary file, never beyond its end."""

    def __init__(self, data: bytes, file: str) -> None:
        self.data, self.file, self.at = data, file, 0

    def take(self, layout: str) -> tuple[Any, ...]:
        return struct.unpack_from(layout, self.data, self.skip(struct.calcsize(layout)))

    def skip(self, size: int) -> int:
        """Where these bytes begin."""
        if size > len(self.data) - self.at:
            raise CameraError(f"{self.file}: ends after {len(self.data)} bytes, in the middle of an entry")
        self.at += size
        return self.at - size

    def text(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + 4096)
        if end < 0:
            raise CameraError(f"{self.file}: byte {self.at}: an image has no name")
        text = self.data[self.at : end].decode("utf-8", "replace")
        self.at = end + 1
        return text


def _binary_cameras(data: bytes, file: str) -> dict[int, _Intrinsics]:
    reader = _Reader(data, file)
    (count,) = reader.take("<Q")
    cameras = {}
    for k in range(count):  # every turn takes bytes that are there, whatever the count says
        where = f"{file}: entry {k}"
        key, number, width, height = reader.take("<iiQQ")
        name = _NAMES.get(number, f"number {number}")
        if name not in _LENSES:
            _intrinsics(name, width, height, [], where)
        parameters = reader.take(f"<{_LENSES[name][1]}d")
        cameras[key] = _intrinsics(name, width, height, list(parameters), where)
    return cameras


def _binary_images(data: bytes, file: str) -> list[_Image]:
    reader = _Reader(data, file)
    (count,) = reader.take("<Q")
    images = []
    for k in range(count):
        values = reader.take("<i7di")
        name = reader.text()
        (points,) = reader.take("<Q")
        reader.skip(24 * points)
        images.append(_Image(name, values[1:5], values[5:8], values[8], f"{file}: entry {k} ({name[:80]})"))
    return images
