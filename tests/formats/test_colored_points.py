"""Colored points and corners of meshes, as suspects: what each kind of file says of places and colors."""

from __future__ import annotations

import base64
import io
import json
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.gltf.container import unpack
from engine.formats.points import read_points
from engine.model import SH_C0
from engine.numerics.srgb import from_linear, to_linear
from engine.scenes.scene_files import read_suspect
from tests.formats.damage import little_memory
from tests.formats.gltf_files import glb_of

PLACES = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3], [1, 2, 3], [4, 5, 6]], np.float32)
COLORS = np.linspace(0.05, 0.95, 18).reshape(6, 3)
"""As screens show them."""


def colors_in(data: bytes) -> Any:
    """(N, 3) colors of what is read."""
    found = read_points(data, file="mesh")
    assert found is not None
    model, repairs = found
    np.testing.assert_allclose(model.means, PLACES, atol=1e-6)
    assert [each.code for each in repairs] == ["points"]
    return 0.5 + SH_C0 * model.sh[:, 0].astype(np.float64)


def mesh(
    attributes: dict[str, tuple[Any, str]], generator: str = "", blobs: tuple[bytes, ...] = (), **json: Any
) -> bytes:
    """A GLB of one primitive; each attribute has values and a component type's number after its kind."""
    views, accessors, binary, numbers = [], [], b"", {}
    codes = {"u1": 5121, "u2": 5123, "f4": 5126}
    for name, (values, code) in attributes.items():
        data = np.ascontiguousarray(values, "<" + code).tobytes()
        numbers[name] = len(accessors)
        kind = f"VEC{values.shape[1]}"
        accessors.append(
            {"bufferView": len(views), "componentType": codes[code], "count": len(values), "type": kind}
            | ({"normalized": True} if code != "f4" else {})
        )
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary += data + bytes(-len(data) % 4)
    for blob in blobs:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(blob)})
        binary += blob + bytes(-len(blob) % 4)
    primitive = {"attributes": numbers} | ({"material": 0} if "materials" in json else {})
    parsed = {
        "asset": {"version": "2.0", "generator": generator},
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return glb_of(parsed | json, binary)


@pytest.mark.parametrize(("code", "most", "slack"), [("f4", 1.0, 1e-6), ("u2", 65535, 2e-3), ("u1", 255, 0.04)])
@pytest.mark.parametrize("width", [3, 4])
def test_colors_at_corners_are_linear_light(code: str, most: float, slack: float, width: int) -> None:
    light = np.ones((6, width))
    light[:, :3] = to_linear(COLORS)
    stored = light * most if most == 1 else np.rint(light * most)
    found = colors_in(mesh({"POSITION": (PLACES, "f4"), "COLOR_0": (stored, code)}))
    np.testing.assert_allclose(found, COLORS, atol=slack)


def test_some_programs_store_them_as_screens_show_them() -> None:
    attributes = {"POSITION": (PLACES, "f4"), "COLOR_0": (np.rint(COLORS * 255), "u1")}
    found = colors_in(mesh(attributes, generator="https://github.com/mikedh/trimesh"))
    np.testing.assert_allclose(found, COLORS, atol=0.003)


def textured(coordinates: Any, **changes: Any) -> bytes:
    """Six pixels in a row, one for each corner."""
    picture = io.BytesIO()
    Image.fromarray(np.rint(COLORS * 255).astype(np.uint8)[None]).save(picture, "PNG")
    factor = changes.pop("factor", [1.0, 1.0, 1.0, 1.0])
    said = {"baseColorTexture": {"index": 0}, "baseColorFactor": factor}
    about: dict[str, Any] = {
        "materials": [{"pbrMetallicRoughness": said}],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 2, "mimeType": "image/png"}],
    }
    attributes = {"POSITION": (PLACES, "f4"), "TEXCOORD_0": (coordinates, "f4")}
    return mesh(attributes, blobs=(picture.getvalue(),), **about | changes)


def test_a_texture_gives_its_nearest_pixel_and_repeats() -> None:
    at = np.stack([(np.arange(6) + 0.5) / 6, np.full(6, 0.3)], axis=1)
    np.testing.assert_allclose(colors_in(textured(at)), COLORS, atol=0.003)
    np.testing.assert_allclose(colors_in(textured(at + np.array([2, -3]))), COLORS, atol=0.003)
    half = colors_in(textured(at, factor=[0.5, 0.5, 0.5, 1]))
    np.testing.assert_allclose(half, from_linear(to_linear(COLORS) / 2), atol=0.003)


@pytest.mark.parametrize(
    "change",
    [
        {"images": [{"uri": "wood.png"}]},
        {"textures": [{}]},
        {"extensionsRequired": ["KHR_draco_mesh_compression"]},
        {"materials": [{}]},
    ],
)
def test_what_has_no_colors_in_the_file_is_no_suspect(change: dict[str, Any]) -> None:
    assert read_points(textured(np.zeros((6, 2)), **change), file="x") is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"images": [{"bufferView": 9}]}, "leads nowhere"),
        ({"images": [{"bufferView": 0}]}, "no readable picture"),
        ({"textures": []}, "leads nowhere"),
        ({"factor": ["red"]}, "baseColorFactor"),
    ],
)
def test_damaged_textures_are_named(change: dict[str, Any], words: str) -> None:
    with pytest.raises(FormatError, match=words):
        read_points(textured(np.zeros((6, 2)), **change), file="x")


def test_textures_have_no_more_pixels_than_the_pictures_of_a_suspect(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("engine.formats.textures.MAX_PIXELS_TOGETHER", 5)
    with pytest.raises(FormatError, match="more than 5 pixels"):
        read_points(textured(np.zeros((6, 2))), file="x")


def test_a_mesh_shown_ten_thousand_times_is_refused() -> None:
    attributes = {"POSITION": (np.zeros((200, 3)), "f4"), "COLOR_0": (np.zeros((200, 3)), "f4")}
    with pytest.raises(FormatError, match="claims 2000000 Gaussians"):
        read_points(mesh(attributes, nodes=[{"mesh": 0}] * 10_000), file="x")


@pytest.mark.parametrize("seed", range(4))
def test_damage_is_an_error_of_ours_or_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    whole = textured(np.full((6, 2), 0.25), nodes=[{"mesh": 0, "scale": [1, 2, 3]}])
    for _ in range(150):
        data = bytearray(whole)
        at = int(rng.integers(12, len(data)))
        data[at : at + 1] = bytes(rng.choice(np.frombuffer(b'0"[{e-\xff', np.uint8), 1))
        with suppress(FormatError):
            found = read_points(bytes(data), file="x")
            assert found is None or 1 <= len(found[0]) <= 6


@pytest.mark.parametrize(
    "change",
    [
        {"meshes": [{"primitives": 7}]},
        {"meshes": [{"primitives": [{"attributes": [1]}]}]},
        {"materials": [{"pbrMetallicRoughness": 3}]},
        {"factor": [10**400, 1, 1, 1]},
        {"factor": [float("nan"), 1, 1, 1]},
        {"images": [{"bufferView": 10**30}]},
    ],
)
def test_wrong_kinds_of_values_are_named(change: dict[str, Any]) -> None:
    with pytest.raises(FormatError):
        read_points(textured(np.zeros((6, 2)), **change), file="x")


def test_places_beyond_all_numbers_are_left_out() -> None:
    places = PLACES.copy()
    places[2] = 3e38
    data = textured(np.zeros((6, 2)), nodes=[{"mesh": 0, "scale": [9, 9, 9]}])
    data = data.replace(PLACES.tobytes(), places.tobytes())
    found = read_points(data, file="x")
    assert found is not None
    assert len(found[0]) == 5


def test_an_obj_takes_hardly_more_memory_than_its_bytes() -> None:
    rows = np.random.default_rng(0).random((20_000, 6))
    data = "\n".join("v " + " ".join(f"{x:.6f}" for x in row) for row in rows.tolist()).encode()
    with little_memory(
        6 * len(data)
    ):  # of which the model itself takes four; ten and more where every word is an object
        found = read_points(data, file="x")
    assert found is not None
    np.testing.assert_allclose(found[0].means, rows[:, :3], atol=1e-6)


OBJ = b"mtllib two words.mtl\n" + b"".join(b"v %g %g %g\n" % tuple(p) for p in PLACES.tolist())
COORDINATES = b"".join(b"vt %g 0.3\n" % ((i + 0.5) / 6) for i in range(6))
FACES = b"usemtl skin\r\nf 1/1/1 2/2/1 3/3/1\nf -3/-3 -2/-2 -1/-1\nf 1/6 2/6 3/6\n"


def obj_with(folder: Path, material: str, obj: bytes = OBJ + COORDINATES + FACES, picture: str = "skin.png") -> Path:
    """An OBJ, its materials, and a texture of six pixels in a row, one for each corner, over a row of white."""
    white = np.full((1, 6, 3), 255, np.uint8)
    rows = np.concatenate([white, np.rint(COLORS * 255).astype(np.uint8)[None]])
    (folder / picture).parent.mkdir(exist_ok=True)
    Image.fromarray(rows).save(folder / picture)
    (folder / "two words.mtl").write_text(material)
    (folder / "mesh.obj").write_bytes(obj)
    return folder / "mesh.obj"


@pytest.mark.parametrize(
    ("said", "picture"),
    [
        ("map_Kd skin.png", "skin.png"),
        ("map_Kd -s 1 1 1 skin.png", "skin.png"),
        ("map_Kd the skin.png", "the skin.png"),
        ("map_Kd C:\\work\\mesh\\skin.png", "skin.png"),
        ("map_Kd maps\\skin.png", "maps/skin.png"),
    ],
)
def test_the_texture_of_an_obj_gives_its_corners_colors(said: str, picture: str, tmp_path: Path) -> None:
    path = obj_with(tmp_path, f"newmtl skin\n\t{said}\n", picture=picture)
    loaded = read_suspect(path)
    assert loaded.format == "points"
    np.testing.assert_allclose(loaded.model.means, PLACES, atol=1e-6)
    np.testing.assert_allclose(0.5 + SH_C0 * loaded.model.sh[:, 0], COLORS, atol=0.003)


def test_corners_without_a_texture_are_left_out(tmp_path: Path) -> None:
    obj = OBJ + COORDINATES + b"usemtl skin\nf 1/1 2/2 3/3\nusemtl plain\nf 4/4 5/5 6/6\n"
    loaded = read_suspect(obj_with(tmp_path, "newmtl skin\nmap_Kd skin.png\nnewmtl plain\nKd 1 0 0\n", obj))
    np.testing.assert_allclose(loaded.model.means, PLACES[:3], atol=1e-6)


def test_a_texture_that_is_missing_is_named_and_none_is_read_from_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    Image.new("RGB", (6, 1)).save(tmp_path / "outside.png")
    for name in ("skin.jpg", "../outside.png", "/etc/hostname"):
        path = obj_with(tmp_path / "below", f"newmtl skin\nmap_Kd {name}\n")
        with pytest.raises(FormatError, match="not beside it"):
            read_suspect(path)
    with pytest.raises(FormatError, match="not there"):
        read_suspect(
            obj_with(tmp_path, "newmtl skin\nmap_Kd skin.png\n", OBJ + COORDINATES + FACES + b"f 1/7 2/2 3/3\n")
        )
    with pytest.raises(UnsupportedFormatError, match="is a mesh"):  # what came over the network names no files here
        read_suspect(obj_with(tmp_path, "newmtl skin\nmap_Kd skin.png\n"), name="upload.obj")


@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression"])
def test_packed_meshes_are_refused_with_the_command_that_unpacks_them(name: str, tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(textured(np.zeros((6, 2)), extensionsRequired=[name]))
    with pytest.raises(UnsupportedFormatError, match=rf"packed \({name}\).*gltf-transform/cli copy"):
        read_suspect(tmp_path / "a.glb")


def parted(folder: Path, **changes: Any) -> Path:
    """The mesh of `textured` as a .gltf with its buffer and its picture in files of their own."""
    at = np.stack([(np.arange(6) + 0.5) / 6, np.full(6, 0.3)], axis=1)
    whole = unpack(textured(at), file="x")
    view = whole.row("bufferViews", 2)
    (folder / "the mesh.bin").write_bytes(whole.binary)
    (folder / "maps").mkdir(exist_ok=True)
    picture = bytes(whole.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
    (folder / "maps" / "skin.png").write_bytes(picture)
    said = {
        "buffers": [{"byteLength": len(whole.binary), "uri": "the%20mesh.bin"}],
        "images": [{"uri": "maps/skin.png"}],
    }
    (folder / "mesh.gltf").write_text(json.dumps({**whole.json, **said, **changes}))
    return folder / "mesh.gltf"


def test_a_gltf_names_buffers_and_textures_beside_it(tmp_path: Path) -> None:
    loaded = read_suspect(parted(tmp_path))
    np.testing.assert_allclose(loaded.model.means, PLACES, atol=1e-6)
    np.testing.assert_allclose(0.5 + SH_C0 * loaded.model.sh[:, 0], COLORS, atol=0.003)
    inside = "data:image/png;base64," + base64.b64encode((tmp_path / "maps" / "skin.png").read_bytes()).decode()
    loaded = read_suspect(parted(tmp_path, images=[{"uri": inside}]))
    np.testing.assert_allclose(0.5 + SH_C0 * loaded.model.sh[:, 0], COLORS, atol=0.003)


def test_a_gltf_names_no_file_outside_its_folder(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    Image.new("RGB", (6, 1)).save(tmp_path / "outside.png")
    (tmp_path / "below" / "link.png").symlink_to(tmp_path / "outside.png")
    for uri in ("../outside.png", "%2e%2e/outside.png", "link.png", "/etc/hostname", "https://host/a.png", "a%00.png"):
        with pytest.raises(FormatError, match="not beside it"):
            read_suspect(parted(tmp_path / "below", images=[{"uri": uri}]))
        with pytest.raises(FormatError, match="not beside it"):
            read_suspect(parted(tmp_path / "below", buffers=[{"byteLength": 9, "uri": uri}]))
    with pytest.raises(UnsupportedFormatError, match="holds no Gaussians"):  # of the network: no file is opened
        read_suspect(parted(tmp_path), name="upload.gltf")


def ply_mesh(folder: Path, comments: str, faces: str, vertex: str = "", rows: Any = None, kind: str = "ascii") -> Path:
    """Six vertices, and faces as a triangle and six coordinates each, with the texture of `obj_with`."""
    obj_with(folder, "")
    corners = [[0, 1, 2], [3, 4, 5], [0, 1, 2]]
    at = [[0, 1, 2], [3, 4, 5], [5, 5, 5]]
    head = f"ply\nformat {kind} 1.0\n{comments}element vertex 6\n"
    head += "".join(f"property float {n}\n" for n in "xyz") + vertex + f"element face {len(corners)}\n"
    head += f"property list uchar int vertex_indices\n{faces}end_header\n"
    body = b""
    for k in range(6):
        row = [*PLACES[k].tolist(), *([] if rows is None else rows[k])]
        body += (" ".join(map(str, row)) + "\n").encode() if kind == "ascii" else struct.pack(f"<{len(row)}f", *row)
    for corner, place in zip(corners, at, strict=True):
        uv = [value for p in place for value in ((p + 0.5) / 6, 0.3)] if faces else []
        last = [0] if "texnumber" in faces else []
        row = [3, *corner, *([6, *uv] if uv else []), *last]
        packed = struct.pack("<B3i", 3, *corner) + (struct.pack("<B6f", 6, *uv) if uv else b"")
        packed += struct.pack("<i", 0) if last else b""
        body += (" ".join(map(str, row)) + "\n").encode() if kind == "ascii" else packed
    (folder / "mesh.ply").write_bytes(head.encode() + body)
    return folder / "mesh.ply"


CORNERED = "property list uchar float texcoord\n"
NUMBERED = CORNERED + "property int texnumber\n"
NAMED = "comment VCGLIB generated\ncomment TextureFile skin.png\n"


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("faces", [CORNERED, NUMBERED])
def test_the_texture_of_a_ply_gives_its_corners_colors(faces: str, kind: str, tmp_path: Path) -> None:
    path = ply_mesh(tmp_path, NAMED.replace("skin", "Häute 1"), faces, kind=kind)
    (tmp_path / "skin.png").rename(tmp_path / "Häute 1.png")
    loaded = read_suspect(path)
    assert loaded.format == "points"
    np.testing.assert_allclose(loaded.model.means, PLACES, atol=1e-6)
    np.testing.assert_allclose(0.5 + SH_C0 * loaded.model.sh[:, 0], COLORS, atol=0.003)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("corners", [[[0, 1, 2, 3], [3, 4, 5, 2]], [[0, 1, 2, 3, 4], [2, 4, 5], [1, 2]]])
def test_faces_of_a_textured_ply_may_have_any_number_of_corners(
    corners: list[list[int]], kind: str, tmp_path: Path
) -> None:
    """Quads, as Blender and Instant Meshes leave them, alone or among triangles; the first face has no coordinates."""
    path = ply_mesh(tmp_path, NAMED, NUMBERED, kind=kind)
    head, body = path.read_bytes().split(b"end_header\n")
    vertices = body[: 6 * 12] if kind != "ascii" else b"\n".join(body.split(b"\n")[:6]) + b"\n"
    faces = b""
    for corner in [[1, 0, 5], *corners]:
        uv = [value for c in corner for value in ((c + 0.5) / 6, 0.3)] if corner != [1, 0, 5] else []
        row = [len(corner), *corner, len(uv), *uv, 0]
        packed = struct.pack(f"<B{len(corner)}iB{len(uv)}fi", *row)
        faces += (" ".join(map(str, row)) + "\n").encode() if kind == "ascii" else packed
    head = head.replace(b"element face 3", b"element face %d" % (len(corners) + 1))
    path.write_bytes(head + b"end_header\n" + vertices + faces)
    loaded = read_suspect(path)
    np.testing.assert_allclose(loaded.model.means, PLACES, atol=1e-6)
    np.testing.assert_allclose(0.5 + SH_C0 * loaded.model.sh[:, 0], COLORS, atol=0.003)
    whole = path.read_bytes()
    for cut in (2, 9):
        path.write_bytes(whole[:-cut])
        with pytest.raises(FormatError):
            read_suspect(path)


@pytest.mark.parametrize("names", ["st", "uv"])
def test_a_ply_may_have_its_coordinates_at_its_vertices(names: str, tmp_path: Path) -> None:
    vertex = "".join(f"property float {n}\n" for n in names)
    path = ply_mesh(tmp_path, NAMED, "", vertex, [[(k + 0.5) / 6, 0.3] for k in range(6)])
    np.testing.assert_allclose(0.5 + SH_C0 * read_suspect(path).model.sh[:, 0], COLORS, atol=0.003)


def test_textures_of_a_ply_that_are_missing_are_named(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    Image.new("RGB", (6, 1)).save(tmp_path / "outside.png")
    for name in ("gone.png", "../outside.png", "/etc/hostname"):
        with pytest.raises(FormatError, match="not beside it"):
            read_suspect(ply_mesh(tmp_path / "below", f"comment TextureFile {name}\n", CORNERED))
    path = ply_mesh(tmp_path, NAMED, CORNERED)
    with pytest.raises(UnsupportedFormatError, match="point cloud or a mesh"):  # of the network: no file is opened
        read_suspect(path, name="upload.ply")
    with pytest.raises(UnsupportedFormatError, match="point cloud or a mesh"):
        read_suspect(ply_mesh(tmp_path, "", CORNERED))
    path.write_bytes(ply_mesh(tmp_path, NAMED, CORNERED).read_bytes().replace(b"\n3 0 1 2", b"\n3 0 1 9"))
    with pytest.raises(FormatError, match="names vertex 9"):
        read_suspect(path)
