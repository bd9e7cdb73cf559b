"""Colored corners of meshes, and colored points, in glTF: by colors at the corners, and by the material's texture.

Khronos Group, "glTF 2.0 Specification", sections 3.7.2 and 3.9.2: the color is the product of both and of a factor, in
linear light.
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from engine.errors import FormatError
from engine.formats.gltf.container import Asset, unpack
from engine.formats.gltf.nodes import VISIBILITY, primitives_of, shown_meshes
from engine.formats.guards import check_count
from engine.formats.textures import Textures
from engine.model import Float32, Float64
from engine.numerics.srgb import from_linear, to_linear

_UNDERSTOOD = {VISIBILITY, "KHR_mesh_quantization", "KHR_materials_unlit", "EXT_texture_webp"}
_AS_SHOWN = ("trimesh", "open3d", "tinygltf", "meshlab", "vcg")
"""Parts of the names of programs that store colors at corners as screens show them, against the specification."""


def read_corners(data: bytes, folder: Path | None, *, file: str) -> tuple[Float32, Float32] | None:
    """Places and colors (0 to 1, as screens show them), (N, 3) each, of all that the scene shows; None where nothing
    has colors, or the asset needs an extension that is not understood. The `folder`, if given, is that of the files
    that it may name. Errors are those of `read_gltf`."""
    asset = unpack(data, file=file, folder=folder)
    if not set(map(str, asset.rows("extensionsRequired"))) <= _UNDERSTOOD:
        return None
    shown = [
        (primitive, matrix)
        for mesh, matrix in shown_meshes(asset)
        for primitive in primitives_of(asset, mesh)
        if _has_colors(asset, primitive) and "gaussian_splat" not in str(primitive.get("extensions"))  # of any draft
    ]
    if not shown:
        return None
    size = len(data) + asset.size_beside
    check_count(sum(asset.length(each["attributes"].get("POSITION")) for each, _ in shown), size, file=file)
    textures = Textures(file)
    places, colors = zip(*(_corners(asset, primitive, matrix, textures) for primitive, matrix in shown), strict=True)
    return np.concatenate(places), np.concatenate(colors)


def _has_colors(asset: Asset, primitive: Mapping[str, Any]) -> bool:
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict):
        raise asset.fault("is missing", "primitive", "attributes")
    return "COLOR_0" in attributes or _texture(asset, primitive) is not None


def _corners(
    asset: Asset, primitive: Mapping[str, Any], matrix: Float64, textures: Textures
) -> tuple[Float32, Float32]:
    attributes = primitive["attributes"]
    values = partial(asset.attribute, attributes)
    points = values("POSITION", 3)
    light: Float64 = np.ones((len(points), 3))
    if "COLOR_0" in attributes:
        stored = np.clip(values("COLOR_0", 3, 4)[:, :3], 0, 1).astype(np.float64)
        as_shown = any(name in asset.generator.lower() for name in _AS_SHOWN)
        light = to_linear(stored) if as_shown else stored
    if (texture := _texture(asset, primitive)) is not None:
        image = partial(_content, asset, texture)
        try:
            light = light * to_linear(textures.sample(texture, values("TEXCOORD_0", 2), image))
        except FormatError as error:
            raise error if error.element else asset.fault(error.message, "images") from None
    factor = _base(asset, primitive).get("baseColorFactor", [1.0, 1.0, 1.0, 1.0])
    sound = isinstance(factor, list) and len(factor) == 4
    if not sound or not all(type(each) in (int, float) and 0 <= each <= 1 for each in factor):
        raise asset.fault("is no list of 4 numbers from 0 to 1", "materials", "baseColorFactor")
    light = light * np.array(factor[:3], dtype=np.float64)
    with np.errstate(over="ignore", invalid="ignore"):  # what is no place is left out
        placed = (points.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
    return placed, from_linear(light).astype(np.float32)


def _base(asset: Asset, primitive: Mapping[str, Any]) -> Mapping[str, Any]:
    """What the primitive's material says of its base color; empty where it has none."""
    if "material" not in primitive:
        return {}
    found = asset.row("materials", primitive["material"]).get("pbrMetallicRoughness", {})
    if not isinstance(found, dict):
        raise asset.fault("is no object", "materials", "pbrMetallicRoughness")
    return found


def _texture(asset: Asset, primitive: Mapping[str, Any]) -> int | None:
    """The image of the base color, where it can be had, and its coordinates are there and plain."""
    info = _base(asset, primitive).get("baseColorTexture")
    if not isinstance(info, dict) or info.get("texCoord", 0) != 0 or "extensions" in info:
        return None
    texture = asset.row("textures", info.get("index"))
    extensions = texture.get("extensions", {})
    webp = extensions.get("EXT_texture_webp", {}) if isinstance(extensions, dict) else {}
    index = texture.get("source", webp.get("source") if isinstance(webp, dict) else None)
    if type(index) is not int or "TEXCOORD_0" not in primitive["attributes"]:
        return None
    image = asset.row("images", index)
    uri = str(image.get("uri", ""))
    return index if type(image.get("bufferView")) is int or uri.startswith("data:") or (uri and asset.folder) else None


def _content(asset: Asset, index: int) -> bytes:
    image = asset.row("images", index)
    view = image.get("bufferView")
    return asset.resource(image.get("uri"), f"image {index}", "images") if view is None else asset.blob(view)
