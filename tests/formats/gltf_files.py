"""glTF put together by hand from the specification, and read again number by number."""

from __future__ import annotations

import base64
import json
import struct
from typing import Any

import numpy as np
import numpy.typing as npt

EXTENSION = "KHR_gaussian_splatting"
SIZES = {5120: "b", 5121: "B", 5122: "h", 5123: "H", 5125: "I", 5126: "f"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
TYPES = {width: name for name, width in WIDTHS.items()}


def splats(n: int, degree: int, seed: int = 0) -> dict[str, npt.NDArray[Any]]:
    """Attributes of n Gaussians in glTF's own terms, by semantic."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    names = [f"SH_DEGREE_{band}_COEF_{order}" for band in range(degree + 1) for order in range(2 * band + 1)]
    attributes = {
        "ROTATION": quats / np.linalg.norm(quats, axis=1, keepdims=True),
        "SCALE": np.exp(rng.normal(-3, 1, (n, 3))),
        "OPACITY": rng.uniform(0.02, 0.98, (n, 1)),
        **{name: rng.normal(0, 0.3, (n, 3)) for name in names},
    }
    found = {f"{EXTENSION}:{name}": values.astype(np.float32) for name, values in attributes.items()}
    return {"POSITION": rng.normal(size=(n, 3)).astype(np.float32), **found}


def asset_of(*primitives: dict[str, npt.NDArray[Any]], **changes: Any) -> tuple[dict[str, Any], bytes]:
    """JSON and binary chunk: a mesh and a node for each primitive; integer attributes are normalised."""
    views, accessors, meshes, binary = [], [], [], b""
    for attributes in primitives:
        numbers = {}
        for name, values in attributes.items():
            code = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "f": 5126}[values.dtype.char]
            data = values.tobytes()
            numbers[name] = len(accessors)
            accessors.append(
                {"bufferView": len(views), "componentType": code, "count": len(values), "type": TYPES[values.shape[1]]}
                | ({"normalized": True} if code != 5126 else {})
            )
            views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
            binary += data + bytes(-len(data) % 4)
        said = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
        primitive = {"attributes": numbers, "mode": 0, "extensions": {EXTENSION: said}}
        meshes.append({"primitives": [primitive]})
    parsed: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": list(range(len(meshes)))}],
        "nodes": [{"mesh": k} for k in range(len(meshes))],
        "meshes": meshes,
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return parsed | changes, binary


def glb_of(parsed: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(parsed).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def gltf_of(parsed: dict[str, Any], binary: bytes) -> bytes:
    """The same as text, its buffer in a data URI."""
    uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    return json.dumps(parsed | {"buffers": [{"byteLength": len(binary), "uri": uri}]}, indent=1).encode()


def read_slowly(glb: bytes) -> dict[str, list[tuple[float, ...]]]:
    """Every attribute of the first primitive of a GLB, row by row, as the specification says."""
    magic, version, total = struct.unpack_from("<4sII", glb)
    assert (magic, version, total) == (b"glTF", 2, len(glb))
    length, kind = struct.unpack_from("<II", glb, 12)
    assert (kind, length % 4) == (0x4E4F534A, 0)
    parsed = json.loads(glb[20 : 20 + length])
    size, kind = struct.unpack_from("<II", glb, 20 + length)
    assert (kind, size % 4, 28 + length + size) == (0x004E4942, 0, total)
    binary = glb[28 + length :]
    assert parsed["buffers"][0]["byteLength"] <= size
    primitive = parsed["meshes"][parsed["nodes"][parsed["scenes"][parsed["scene"]]["nodes"][0]]["mesh"]]["primitives"][
        0
    ]
    assert primitive["mode"] == 0
    said = primitive["extensions"][EXTENSION]
    assert (said["kernel"], said["colorSpace"]) == ("ellipse", "srgb_rec709_display")
    assert EXTENSION in parsed["extensionsUsed"]
    found = {}
    for name, number in primitive["attributes"].items():
        accessor = parsed["accessors"][number]
        view = parsed["bufferViews"][accessor["bufferView"]]
        form = "<" + WIDTHS[accessor["type"]] * SIZES[accessor["componentType"]]
        stride = view.get("byteStride", struct.calcsize(form))
        assert view["byteOffset"] % 4 == 0
        first = view["byteOffset"] + accessor.get("byteOffset", 0)
        found[name] = [struct.unpack_from(form, binary, first + i * stride) for i in range(accessor["count"])]
        if name == "POSITION":
            low, high = np.min(found[name], axis=0), np.max(found[name], axis=0)
            assert (accessor["min"], accessor["max"]) == (low.tolist(), high.tolist())
    return found
