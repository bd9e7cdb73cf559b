"""Gaussians in glTF: the extension KHR_gaussian_splatting, read (.glb, .gltf) and written (.glb).

Specification: KhronosGroup/glTF, extensions/2.0/Khronos/KHR_gaussian_splatting (complete, ratified): points with
linear scales and opacities, quaternions x, y, z, w, spherical harmonics with INRIA's signs, one accessor a
coefficient. glTF's axes (left, up, front) are those of PLY turned by half a turn about z, as playcanvas/splat-transform
and SPZ's converter take them. Of the drafts, that of a compression by SPZ (KHR_gaussian_splatting_compression_spz_2) is
read, since 3D Tiles are written so: with the axes that it prescribes, or where a primitive names no kernel, with those
of Cesium's tiles, which hold glTF's axes as they are. Other drafts are refused by name.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.declaration import Place
from engine.formats.gltf.container import MAGIC, UNPACK, Asset, pack_glb, unpack
from engine.formats.gltf.nodes import VISIBILITY, placed, primitives_of, shown_meshes
from engine.formats.guards import check_count
from engine.formats.ply.extras import named
from engine.formats.repairs import Repair, clean, degree_dropped
from engine.formats.spz.frames import FrameChange
from engine.formats.spz.stream import read_spz
from engine.model import Float32, GaussianModel
from engine.numerics.plain import Json

EXTENSION = "KHR_gaussian_splatting"
COLOR_SPACE = "srgb_rec709_display"
TO_PLY = FrameChange(np.array([-1.0, -1.0, 1.0]))
"""Half a turn about z; its own inverse."""

SPZ = EXTENSION + "_compression_spz_2"
_KNOWN = {EXTENSION, SPZ, VISIBILITY, "KHR_mesh_quantization", "KHR_materials_unlit"}
"""What a file may require: the second allows integers for positions, the third says how points look elsewhere."""
_SCENE = {"asset", "extensionsUsed", "extensionsRequired", "scene", "scenes", "nodes", "meshes"}
_SCENE |= {"buffers", "bufferViews", "accessors"}
_ABOUT = {"version", "minVersion", "generator", "extensions"}
"""Members that are read, or say nothing that could be lost; extensions are named by their list."""

_PACKINGS = {
    "KHR_draco_mesh_compression": UNPACK,
    "EXT_meshopt_compression": UNPACK,
    "KHR_meshopt_compression": UNPACK,
    "KHR_texture_basisu": "export it with PNG or JPEG textures",
}
_FLOAT, _POINTS, _ARRAY_BUFFER = 5126, 0, 34962
_DRAFTS = ("KHR_gaussian_splatting_", "KHR_spz_", "EXT_gaussian_splatting")
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def looks_like_gltf(data: bytes | memoryview) -> bool:
    """Whether bytes begin as a GLB, or are the JSON of a .gltf: an object that names a version in its `asset`, which
    tiles of 3D Tiles do as well. JSON that cannot be parsed, with such a member, is a damaged one."""
    head = bytes(data[:1024]).removeprefix(b"\xef\xbb\xbf")
    if head.startswith(MAGIC):
        return True
    if head.lstrip()[:1] != b"{" or any(byte < 32 and byte not in b"\t\n\r" for byte in head):
        return False
    text = bytes(data)
    if b'"asset"' not in text or b'"geometricError"' in text:
        return False
    try:
        asset = json.loads(text).get("asset")
    except (ValueError, RecursionError):
        return True
    return isinstance(asset, dict) and "version" in asset


def read_gltf(data: bytes, *, file: str, place: Place | None = None) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """All Gaussians that the scene shows, in PLY's axes, primitive after primitive.

    FormatError if lengths, indices and counts do not agree, which is checked before anything is decoded;
    UnsupportedFormatError if there are no Gaussians, or they need an extension, a kernel, a color space or a
    transformation that has no place here.
    """
    place = place or Place()
    asset = replace(unpack(data, file=file, folder=place.folder), opened=place.opened)
    if unknown := [name for name in map(str, asset.rows("extensionsRequired")) if name not in _KNOWN]:
        raise _unsupported(asset, unknown[0])
    shown = [(primitive, matrix) for mesh, matrix in shown_meshes(asset) for primitive in _primitives(asset, mesh)]
    if not shown:
        message = f"holds no Gaussians, only a mesh or points: no primitive that is shown has {EXTENSION}; verify also"
        message += " takes pictures of it, and a mesh with colors at its corners or a texture inside"
        raise UnsupportedFormatError(message, file=file, element="meshes")
    plain = [_attributes(asset, primitive) for primitive, _ in shown if _spz_view(primitive) is None]
    if plain:
        size = len(data) + asset.size_beside
        check_count(sum(asset.length(attributes["POSITION"]) for attributes in plain), size, file=file)
    flip = np.diag([*TO_PLY.signs, 1.0])
    parts = ((*_read_primitive(asset, primitive), flip @ matrix @ flip) for primitive, matrix in shown)
    model, repairs = placed(parts, file=file)
    return model, (*_left_out(asset, [primitive for primitive, _ in shown]), *repairs)


def _left_out(asset: Asset, shown: list[Mapping[str, Any]]) -> list[Repair]:
    """A note on all that is no Gaussian of the scene: nothing else is read, or written again."""
    about = asset.json.get("asset")
    found = [key for key, value in asset.json.items() if key not in _SCENE and value]
    found += [key for key in (about if isinstance(about, dict) else ()) if key not in _ABOUT]
    found += [name for name in map(str, asset.rows("extensionsUsed")) if name not in _KNOWN]
    meshes = {mesh for mesh, _ in shown_meshes(asset)}
    others = sum(len(primitives_of(asset, mesh)) for mesh in meshes) - len({id(primitive) for primitive in shown})
    found += [f"{others} meshes or points without Gaussians"] if others else []
    hidden = len(asset.rows("meshes")) - len(meshes)
    found += [f"{hidden} meshes that its scene does not show"] if hidden else []
    attributes = {name: None for primitive in shown for name in primitive.get("attributes", ())}
    found += [name for name in attributes if not name.startswith((EXTENSION, "POSITION", "COLOR_0"))]
    found += ["targets"] if any("targets" in primitive for primitive in shown) else []
    if not found:
        return []
    return [Repair("extra_gltf", len(found), f"what is no Gaussian of the scene was ignored: {named(found)}")]


def write_glb(model: GaussianModel) -> list[bytes]:
    """The file in pieces, float32 throughout: centres, quaternions and harmonics come back with the same bits, scales
    and opacities to within float32's rounding of the exponential and the logistic function."""
    names = [f"{EXTENSION}:{name}" for name in ("ROTATION", "SCALE", "OPACITY")]
    names += [f"{EXTENSION}:{name}" for name in coefficient_names(model.sh_degree)]
    means, quats, sh = model.means.copy(), model.quats.copy(), model.sh.copy()
    TO_PLY.apply_signs(means, quats, sh)
    opacities = 1.0 / (1.0 + np.exp(-model.opacity_logits.astype(np.float64)))
    columns = [means, quats[:, [1, 2, 3, 0]], model.scales, opacities[:, None], *np.moveaxis(sh, 1, 0)]
    views, accessors, binary, offset = [], [], [], 0
    for number, column in enumerate(columns):
        part = np.ascontiguousarray(column, dtype="<f4").tobytes()
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(part), "target": _ARRAY_BUFFER})
        kind = _TYPES[column.shape[1]]
        accessors.append({"bufferView": number, "componentType": _FLOAT, "count": len(model), "type": kind})
        binary.append(part)
        offset += len(part)
    accessors[0] |= {"min": means.min(axis=0).tolist(), "max": means.max(axis=0).tolist()}
    said = {"kernel": "ellipse", "colorSpace": COLOR_SPACE}
    primitive = {
        "attributes": {name: number for number, name in enumerate(["POSITION", *names])},
        "mode": _POINTS,
        "extensions": {EXTENSION: said},
    }
    parsed: Json = {
        "asset": {"version": "2.0", "generator": "Mark3DGS"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return pack_glb(parsed, binary)


def coefficient_names(degree: int) -> list[str]:
    """Semantics of the coefficients up to a degree, in INRIA's order."""
    return [f"SH_DEGREE_{band}_COEF_{order}" for band in range(degree + 1) for order in range(2 * band + 1)]


def _unsupported(asset: Asset, name: str) -> UnsupportedFormatError:
    if name in _PACKINGS:
        return UnsupportedFormatError(f"is packed ({name}): {_PACKINGS[name]}", file=asset.file, element="extensions")
    draft = ", a draft that is not settled" if name.startswith(_DRAFTS) else ""
    message = f"needs the extension {ascii(name)[:80]}{draft}; export uncompressed {EXTENSION}, .spz or .ply"
    return UnsupportedFormatError(message, file=asset.file, element="extensions")


def _primitives(asset: Asset, mesh: object) -> Iterator[Mapping[str, Any]]:
    """Those of a mesh that hold Gaussians, once their extension says nothing that is not known here."""
    for primitive in primitives_of(asset, mesh):
        extensions = primitive.get("extensions", {})
        if not isinstance(extensions, dict):
            raise asset.fault("is no object", f"mesh {mesh}", "extensions")
        said = extensions.get(EXTENSION)
        if said is None:
            drafts = [name for name in extensions if name.startswith(_DRAFTS)]
            if drafts:
                raise _unsupported(asset, drafts[0])
            continue
        if not isinstance(said, dict):
            raise asset.fault("is no object", f"mesh {mesh}", EXTENSION)
        _check_said(asset, said, mesh)
        if primitive.get("mode") != _POINTS:
            raise asset.fault(f"mode is {primitive.get('mode')!r:.20}, expected {_POINTS}", f"mesh {mesh}", "mode")
        yield primitive


def _check_said(asset: Asset, said: Mapping[str, Any], mesh: object) -> None:
    """Refuse what the extension of a primitive says and nothing here knows."""
    nested = said.get("extensions", {})
    if not isinstance(nested, dict) or set(nested) - {SPZ}:
        raise _unsupported(asset, min(map(str, set(nested) - {SPZ})) if isinstance(nested, dict) else str(nested))
    if nested and not isinstance(nested[SPZ], dict):
        raise asset.fault("is no object", f"mesh {mesh}", SPZ)
    if nested and "kernel" not in said:  # a tile of Cesium's
        return
    if not {"kernel", "colorSpace"} <= said.keys():
        by = f", written by {ascii(asset.generator)[:80]}" if asset.generator else ""
        message = f"is of a draft of {EXTENSION}, which names no kernel or color space{by}: update that program and"
        message += " export the scene again, or export it as .ply or .spz"
        raise UnsupportedFormatError(message, file=asset.file, element=EXTENSION)
    for key, wanted in (("kernel", "ellipse"), ("colorSpace", COLOR_SPACE), ("projection", "perspective")):
        if said.get(key, wanted) != wanted:
            message = f"{said[key]!r:.60} is not read here, only {wanted!r}"
            raise UnsupportedFormatError(message, file=asset.file, element=EXTENSION, prop=key)


def _attributes(asset: Asset, primitive: Mapping[str, Any]) -> Mapping[str, Any]:
    found = primitive.get("attributes")
    if not isinstance(found, dict):
        raise asset.fault("is missing", "primitive", "attributes")
    for name in ("POSITION", *(f"{EXTENSION}:{n}" for n in ("ROTATION", "SCALE", "OPACITY", "SH_DEGREE_0_COEF_0"))):
        if name not in found:
            raise asset.fault("is missing", "primitive", name)
    return found


def _degree(asset: Asset, primitive: Mapping[str, Any]) -> int:
    """Degree of the harmonics, 0 to 4, once each is there whole with all below it."""
    there = {name.partition(":")[2] for name in _attributes(asset, primitive) if name.startswith(EXTENSION + ":SH_")}
    for degree in range(5):
        if there == set(coefficient_names(degree)):
            return degree
    message = f"{len(there)} coefficients of spherical harmonics are no whole degrees"
    raise FormatError(message, file=asset.file, element="primitive")


def _spz_view(primitive: Mapping[str, Any]) -> object | None:
    """The buffer view with an SPZ file in it, of a compressed primitive; -1, which is none, where it is not named."""
    nested = primitive["extensions"][EXTENSION].get("extensions")
    return nested[SPZ].get("bufferView", -1) if nested else None


def _read_spz(asset: Asset, primitive: Mapping[str, Any]) -> tuple[GaussianModel, tuple[Repair, ...]]:
    as_stored = "kernel" not in primitive["extensions"][EXTENSION]
    model, repairs = read_spz(asset.blob(_spz_view(primitive)), file=asset.file, frame="ply" if as_stored else "spec")
    if as_stored:
        TO_PLY.apply_signs(model.means, model.quats, model.sh)
    return model, repairs


def _read_primitive(asset: Asset, primitive: Mapping[str, Any]) -> tuple[GaussianModel, tuple[Repair, ...]]:
    if _spz_view(primitive) is not None:
        return _read_spz(asset, primitive)
    attributes = _attributes(asset, primitive)
    count = asset.length(attributes["POSITION"])

    def values(name: str, width: int) -> npt.NDArray[np.float32]:
        return asset.attribute(attributes, f"{EXTENSION}:{name}", width)

    means, quats = asset.attribute(attributes, "POSITION", 3), values("ROTATION", 4)[:, [3, 0, 1, 2]]
    scales, opacities = values("SCALE", 3), values("OPACITY", 1)[:, 0].astype(np.float64)
    degree = _degree(asset, primitive)
    sh = np.empty((count, (min(degree, 3) + 1) ** 2, 3), dtype=np.float32)
    for k, name in enumerate(coefficient_names(min(degree, 3))):
        sh[:, k] = values(name, 3)
    TO_PLY.apply_signs(means, quats, sh)
    repairs: tuple[Repair, ...] = (degree_dropped(degree, count),) if degree > 3 else ()
    with np.errstate(divide="ignore", invalid="ignore"):  # 0 and 1 are mended, what lies outside is a fault
        log_scales: Float32 = np.log(scales)
        logits = np.log(opacities) - np.log1p(-opacities)
    if asset.generator.startswith("splat-transform") and (scales < 0).any():
        log_scales = scales
        text = "sizes were stored as logarithms, as early splat-transform did against the specification"
        repairs += (Repair("scales_logarithmic", count, text),)
    model, mended = clean(means, log_scales, quats, logits, sh, file=asset.file, element="primitive")
    return model, (*repairs, *mended)
