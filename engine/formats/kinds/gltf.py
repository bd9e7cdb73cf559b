"""GLB and glTF with KHR_gaussian_splatting, see `engine.formats.gltf`."""

from collections.abc import Iterable

from engine.formats.declaration import Kind, Read
from engine.model import GaussianModel


def _is_one(data: bytes, file: str) -> bool:
    from engine.formats.gltf.scene import looks_like_gltf

    return looks_like_gltf(data)


def _read(data: bytes, file: str, spz_frame: str) -> Read:
    from engine.formats.gltf.scene import read_gltf

    return read_gltf(data, file=file)


def _write(model: GaussianModel) -> Iterable[bytes]:
    from engine.formats.gltf.scene import write_glb

    return write_glb(model)


KINDS = (Kind("glb", _is_one, _read, _write, holds=("harmonics",)),)
