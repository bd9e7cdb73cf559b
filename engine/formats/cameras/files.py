"""Cameras from the files of other programs, recognized by their content; INRIA's JSON is written."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from engine.errors import CameraError
from engine.formats.cameras.documents import DATAPARSER, read_inria, read_nerf
from engine.formats.file_writing import write_whole
from engine.formats.guards import opening, read_regular
from engine.model import Camera

MAX_CAMERA_BYTES = 1 << 28
"""A COLMAP images.txt of a thousand photos has 100 MB, nearly all of it points."""

SUBFOLDERS = ("", "sparse/0", "sparse", "colmap/sparse/0")
"""Where a COLMAP model usually lies within what the user calls its folder."""

_READ = (
    "read are cameras.json (INRIA), transforms.json (NeRF, nerfstudio) and models of COLMAP; leave --cameras out, and"
    " cameras of pictures are found"
)
_JSON_NAMES = ("cameras.json", "transforms.json", "transforms_train.json")


def read_cameras(path: str | os.PathLike[str]) -> list[Camera]:
    """Read cameras, in the OpenCV frame, from INRIA's cameras.json, NeRF's transforms.json or a COLMAP model.

    `path` is a JSON file; or a COLMAP model, text or binary, by its folder or by one of its files; or a folder that
    holds one of these under its usual name (``sparse/0``, ``cameras.json``, ``transforms.json``). They are in the order
    of the file; of a COLMAP model, in the order of the images' names. Where ``transforms.json`` gives an
    ``applied_transform`` (nerfstudio), it is undone: the cameras are then in the frame of the reconstruction; or, where
    ``dataparser_transforms.json`` lies next to it, in that of the trained model.

    CameraError, naming the file and the entry, if the file is not what it should be; InputError if there is none. A
    UserWarning says where lens distortion is ignored: all cameras of this program are pinholes.
    """
    path = Path(path)
    with opening(path, str(path)):
        if path.is_dir():
            return _read_folder(path)
        if path.name in ("cameras.txt", "images.txt", "cameras.bin", "images.bin"):
            return _read_colmap(path.parent, path.suffix)
        return _read_json(path)


def write_cameras(cameras: Sequence[Camera], path: str | os.PathLike[str]) -> int:
    """Write cameras in the layout of INRIA's cameras.json, with the principal point besides; returns the bytes written.

    The file is replaced in one step. `read_cameras` gives the same cameras back, to rounding of float64. InputError if
    it cannot be written.
    """
    entries = [
        {
            "id": k,
            "img_name": f"{k:05d}",
            "width": camera.width,
            "height": camera.height,
            "position": camera.position.tolist(),
            "rotation": camera.viewmat[:3, :3].T.tolist(),
            "fx": float(camera.K[0, 0]),
            "fy": float(camera.K[1, 1]),
            "cx": float(camera.K[0, 2]),
            "cy": float(camera.K[1, 2]),
        }
        for k, camera in enumerate(cameras)
    ]
    text = ",\n".join(json.dumps(entry) for entry in entries)
    return write_whole(path, [f"[\n{text}\n]\n".encode("ascii")])


def _read_folder(folder: Path) -> list[Camera]:
    for subfolder in SUBFOLDERS:
        for suffix in (".bin", ".txt"):
            if all(file.is_file() for file in _colmap_files(folder / subfolder, suffix)):
                return _read_colmap(folder / subfolder, suffix)
    for name in _JSON_NAMES:
        if (folder / name).is_file():
            return _read_json(folder / name)
    neither = "neither a COLMAP model (cameras and images, .txt or .bin)"
    raise CameraError(f"{folder}: holds no cameras: {neither} nor {', '.join(_JSON_NAMES)}")


def _colmap_files(folder: Path, suffix: str) -> tuple[Path, Path]:
    return folder / f"cameras{suffix}", folder / f"images{suffix}"


def _read_colmap(folder: Path, suffix: str) -> list[Camera]:
    from engine.formats.cameras.colmap import read_colmap  # scipy costs 0.2 s, and most callers read JSON

    cameras, images = _colmap_files(folder, suffix)
    return read_colmap(read_limited(cameras), read_limited(images), str(cameras), str(images), binary=suffix == ".bin")


def _read_json(path: Path) -> list[Camera]:
    content = json_of(path)
    if isinstance(content, list) and content and isinstance(content[0], dict) and "transform" in content[0]:
        message = f"holds poses without lenses (ns-export cameras): give transforms.json with {DATAPARSER} next to it"
        raise CameraError(f"{path}: {message}")
    if isinstance(content, list):
        return read_inria(content, str(path))
    if isinstance(content, dict) and isinstance(content.get("frames"), list):
        beside = path.parent / DATAPARSER
        moved = json_of(beside) if beside.is_file() else None
        return read_nerf(content, str(path), path.parent, moved if isinstance(moved, dict) else None)
    if isinstance(content, dict) and {"transform", "scale"} <= content.keys():
        raise CameraError(f"{path}: holds no cameras: put it next to the transforms.json of the scene, and give that")
    raise CameraError(f"{path}: is neither a list of cameras (INRIA) nor holds a list 'frames' (NeRF); {_READ}")


def json_of(path: Path) -> Any:
    """The content of a JSON file; CameraError where it is none."""
    try:
        return json.loads(read_limited(path))
    except (ValueError, RecursionError) as error:
        where = f" (line {error.lineno})" if isinstance(error, json.JSONDecodeError) else ""
        raise CameraError(f"{path}: is no JSON{where}; {_READ}") from None


def read_limited(path: Path) -> bytes:
    """A regular file of at most `MAX_CAMERA_BYTES`, whole."""
    if (size := path.stat().st_size) > MAX_CAMERA_BYTES:
        raise CameraError(f"{path}: has {size} bytes, more than the {MAX_CAMERA_BYTES} that cameras may have")
    return read_regular(path, str(path))
