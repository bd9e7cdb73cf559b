"""glTF against bytes that are cut, changed, or lie about their sizes."""

from __future__ import annotations

import copy
import json
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import FormatError
from engine.formats.gltf.scene import read_gltf
from tests.formats.damage import JUNK, MUTATIONS, little_memory, mutated, places, survives, with_value
from tests.formats.gltf_files import EXTENSION, asset_of, glb_of, splats

PARSED, BINARY = asset_of(splats(12, 1), nodes=[{"mesh": 0, "translation": [1, 2, 3]}])
WHOLE = glb_of(PARSED, BINARY)


def test_every_cut_and_every_tail_is_refused_by_name() -> None:
    for length in range(len(WHOLE)):
        with pytest.raises(FormatError, match=r"^scan\.glb"):
            read_gltf(WHOLE[:length], file="scan.glb")
    with pytest.raises(FormatError, match="says it has"):
        read_gltf(WHOLE + b"\0", file="scan.glb")


def changed(*path: Any, value: Any) -> bytes:
    return glb_of(with_value(PARSED, path, value), BINARY)


PRIMITIVE = ("meshes", 0, "primitives", 0)
LOOP = [{"children": [0], "mesh": 0}]


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (changed("accessors", 0, "count", value=1 << 40), "claims 1099511627776 Gaussians"),
        (changed("accessors", 0, "count", value=13), "13 rows end at byte 156 of a view of 144"),
        (changed("accessors", 1, "count", value=11), "has 11 rows, POSITION 12"),
        (changed("accessors", 0, "count", value=0), "holds 0 Gaussians"),
        (changed("accessors", 0, "count", value=-1), "is no number"),
        (changed("accessors", 0, "count", value=1.5), "is no number"),
        (changed("accessors", 0, "count", value=True), "is no number"),
        (changed("accessors", 0, "type", value="VEC4"), "expected 3 numbers a row"),
        (changed("accessors", 0, "componentType", value=5130), "5130"),
        (changed("accessors", 0, "bufferView", value=99), "index 99 leads nowhere"),
        (changed("accessors", 0, "bufferView", value="0"), "index '0' leads nowhere"),
        (changed("accessors", 0, "sparse", value={"count": 1}), "is sparse"),
        (changed("accessors", 0, "byteOffset", value=8), "end at byte 152"),
        (changed("bufferViews", 0, "byteLength", value=1 << 50), "of a view of 1125899906842624"),
        (changed("bufferViews", 0, "byteOffset", value=len(BINARY)), "in a buffer of"),
        (changed("bufferViews", 0, "byteStride", value=4), "end at byte"),
        (changed("bufferViews", 0, "extensions", value={"EXT_meshopt_compression": {}}), "has extensions"),
        (changed("bufferViews", 0, "extensions", value=3), "has extensions"),
        (changed("buffers", value=[]), "there are 0"),
        (changed("buffers", 0, value={"byteLength": 4, "uri": 5}), "another file"),
        (changed("buffers", 0, value={"uri": "data:application/octet-stream;base64,!!"}), "no base64"),
        (changed("nodes", value=LOOP), "node 0 is there twice"),
        (changed("nodes", value=[{"mesh": 7}]), "index 7 leads nowhere"),
        (changed("nodes", value=[{"mesh": 0, "rotation": [0, 0, 0, 0]}]), "rotation of zeros"),
        (changed("nodes", value=[{"mesh": 0, "matrix": [1, 2]}]), "needs 16 finite numbers"),
        (changed("nodes", value=[{"mesh": 0, "translation": [1, 2, float("nan")]}]), "needs 3 finite numbers"),
        (changed("nodes", value=[{"mesh": 0, "scale": [0, 0, 0]}]), "stretches"),
        (changed("nodes", value=[{}] * (1 << 15)), "32768 nodes"),
        (changed("nodes", 0, value=[]), "is no object"),
        (changed("scenes", value={"nodes": [0]}), "is no list"),
        (changed("scenes", 0, "nodes", value=["0"]), "no list of indices"),
        (changed("meshes", 0, "primitives", value={}), "no list of primitives"),
        (changed(*PRIMITIVE, "mode", value=4), "mode is 4, expected 0"),
        (changed(*PRIMITIVE, "extensions", value=[]), "is no object"),
        (changed(*PRIMITIVE, "extensions", EXTENSION, value=1), "is no object"),
        (changed(*PRIMITIVE, "extensions", EXTENSION, "extensions", value=5), "needs the extension"),
        (changed(*PRIMITIVE, "attributes", value={"POSITION": 0}), "'KHR_gaussian_splatting:ROTATION': is missing"),
        (changed(*PRIMITIVE, "attributes", f"{EXTENSION}:SH_DEGREE_2_COEF_0", value=0), "no whole degrees"),
        (changed(*PRIMITIVE, "attributes", f"{EXTENSION}:SH_DEGREE_4_COEF_0", value=0), "no whole degrees"),
        (changed("extensionsRequired", value=[["a"]]), "needs the extension"),
        (changed("extensionsRequired", value="EXT"), "is no list"),
        (glb_of([], b""), "is no JSON object"),  # type: ignore[arg-type]
        (b"glTF" + struct.pack("<IIII", 2, 24, 4, 0x4E4F534A) + b"[[[[", "is no JSON"),
        (b'{"a": ' + b"[" * 100_000, "is no JSON"),
        (b"glTF" + struct.pack("<IIII", 2, 40, 1 << 31, 0x4E4F534A) + bytes(20), "the first chunk"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(data: bytes, what: str) -> None:
    with little_memory(1 << 23), pytest.raises(FormatError, match=r"^scan\.glb.*" + what):
        read_gltf(data, file="scan.glb")


def test_a_mesh_that_is_shown_very_often_costs_no_memory() -> None:
    """16,000 nodes that show one mesh of a million Gaussians, all of them the same row."""
    parsed, binary = copy.deepcopy(PARSED), BINARY + bytes(12_000_000)
    parsed["nodes"] = [{"mesh": 0}] * 16_000
    parsed["scenes"] = [{"nodes": list(range(16_000))}]
    parsed["bufferViews"] = [{"buffer": 0, "byteLength": len(binary)}] * len(parsed["bufferViews"])
    for accessor in parsed["accessors"]:
        accessor["count"] = 700_000
    data = glb_of(parsed, binary)
    with little_memory(1 << 26), pytest.raises(FormatError, match="claims 11200000000 Gaussians"):
        read_gltf(data, file="x")


@settings(max_examples=400)
@given(st.sampled_from(places(PARSED)[1:]), JUNK)
def test_json_that_says_anything_gives_a_format_error_or_a_valid_model(path: tuple[Any, ...], junk: Any) -> None:
    survives(read_gltf, changed(*path, value=junk))


@settings(max_examples=300)
@given(MUTATIONS, st.booleans())
def test_damaged_bytes_give_a_format_error_or_a_valid_model(mutations: list[tuple[int, int]], text: bool) -> None:
    survives(read_gltf, mutated(json.dumps(PARSED).encode() if text else WHOLE, mutations))
