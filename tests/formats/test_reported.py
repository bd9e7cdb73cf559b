"""Files as users of other programs report them: what each holds, or what to give in its place."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats import encode_model, read_cameras, read_model
from engine.formats.cameras.fisheye import FisheyeCamera
from engine.formats.points import read_points
from engine.formats.sog.bundle import read_sog, write_sog
from tests.formats.gltf_files import asset_of, glb_of, gltf_of, splats
from tests.formats.models import assert_same, names_of, random_model, rows_for
from tests.formats.sog_scenes import bundle, unbundle


def gsbox(said: dict[str, Any]) -> None:
    said["bands"] = 0


def lichtfeld(said: dict[str, Any]) -> None:
    said["palette_size"] = said.pop("count")


@pytest.mark.parametrize("change", [gsbox, lichtfeld])
def test_a_sog_that_says_little_of_its_harmonics(change: Callable[[dict[str, Any]], None]) -> None:
    whole = write_sog(random_model(2, 700))
    parts = unbundle(whole)
    meta = json.loads(parts["meta.json"])
    change(meta["shN"])
    changed = read_sog(bundle(parts | {"meta.json": json.dumps(meta).encode()}), file="x")[0]
    np.testing.assert_array_equal(changed.sh, read_sog(whole, file="x")[0].sh)


def plain_ply(names: list[str], rows: np.ndarray) -> bytes:
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    head += [*(f"property float {name}" for name in names), "end_header", ""]
    return "\n".join(head).encode() + rows.astype("<f4").tobytes()


BALLS = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0"]


@pytest.mark.parametrize("turned", [True, False])
def test_balls_of_one_scale(turned: bool) -> None:
    names = [*BALLS, *(f"rot_{i}" for i in range(4) if turned)]
    rows = np.random.default_rng(0).normal(0, 0.4, (300, len(names)))
    loaded = read_model(plain_ply(names, rows))
    np.testing.assert_allclose(loaded.model.log_scales, np.repeat(rows[:, 7:8], 3, axis=1), rtol=1e-6)
    if turned:
        quats = rows[:, 8:] / np.linalg.norm(rows[:, 8:], axis=1, keepdims=True)
        np.testing.assert_allclose(loaded.model.quats, quats, atol=1e-6)
    assert loaded.repairs[0].code == "isotropic"
    assert not loaded.model.is_flat
    back = read_model(encode_model(loaded.model, "ply"))
    np.testing.assert_array_equal(back.model.log_scales, loaded.model.log_scales)
    with pytest.raises(FormatError, match="rot_3"):
        read_model(plain_ply([*BALLS, "rot_0", "rot_1", "rot_2"], rows[:, [*range(8), 0, 1, 2]]))


NAMES = ["x", "y", "z", "nx", "ny", "nz", *names_of(1)[3:]]
ROWS = rows_for(NAMES, 40)


@pytest.mark.parametrize(
    ("other", "own"),
    [
        (["rot_w", "rot_x", "rot_y", "rot_z"], "rot"),
        (["rotation_0", "rotation_1", "rotation_2", "rotation_3"], "rot"),
        (["scale_x", "scale_y", "scale_z"], "scale"),
        (["scaling_0", "scaling_1", "scaling_2"], "scale"),
        (["qw", "qx", "qy", "qz"], "rot"),
        (["features_dc_0", "features_dc_1", "features_dc_2"], "f_dc"),
        (["sh_dc_0", "sh_dc_1", "sh_dc_2"], "f_dc"),
    ],
)
def test_names_of_scripts(other: list[str], own: str) -> None:
    table = {f"{own}_{i}": name for i, name in enumerate(other)}
    loaded = read_model(plain_ply([table.get(name, name) for name in NAMES], ROWS))
    assert_same(loaded.model, read_model(plain_ply(NAMES, ROWS)).model)
    assert loaded.repairs[0].code == "names_replaced"
    assert loaded.repairs[0].count == len(other)


def test_colors_sizes_and_rotations_as_lists() -> None:
    plain = names_of(0)
    rows = rows_for(plain, 40)
    kinds = [("xyz", "<f4", 3), ("n", "u1"), ("dc", "<f4", 3), ("o", "<f4"), ("m", "u1"), ("s", "<f4", 3), ("l", "u1")]
    table = np.zeros(40, [*kinds, ("q", "<f4", 4)])
    table["n"], table["m"], table["l"] = 3, 3, 4
    table["xyz"], table["dc"], table["o"] = rows[:, :3], rows[:, 3:6], rows[:, 6]
    table["s"], table["q"] = rows[:, 7:10], rows[:, 10:]
    head = plain_ply(["x", "y", "z", "f_dc", "opacity", "scale", "rot"], np.zeros((40, 7))).split(b"end_header\n")[0]
    for name in (b"f_dc", b"scale", b"rot"):
        head = head.replace(b"float " + name, b"list uchar float " + name)
    loaded = read_model(head + b"end_header\n" + table.tobytes())
    assert_same(loaded.model, read_model(plain_ply(plain, rows)).model)
    assert loaded.repairs[0].code == "names_replaced"
    assert_same(read_model(encode_model(loaded.model, "ply")).model, loaded.model)


def test_names_that_are_not_known_are_named() -> None:
    names = [name.replace("f_dc_", "colour_") for name in NAMES]
    with pytest.raises(FormatError, match=r"'f_dc_0': is missing; not known here: 'colour_0', .*codebook"):
        read_model(plain_ply(names, ROWS))


@pytest.mark.parametrize("other", ["features_rest", "sh", "sh_rest"])
def test_harmonics_of_another_name_are_not_lost(other: str) -> None:
    """Their order is not known: coefficient after coefficient, or channel after channel."""
    names = [name.replace("f_rest", other) for name in NAMES]
    with pytest.raises(FormatError, match=rf"'f_rest_0': is missing, but 9 properties such as '{other}_0'"):
        read_model(plain_ply(names, ROWS))
    assert read_model(plain_ply([*NAMES, "sh_0"], np.hstack([ROWS, ROWS[:, :1]]))).model.sh_degree == 1
    plain = [name for name in NAMES if not name.startswith("f_rest")]
    with pytest.raises(FormatError, match="'f_rest_0': is missing, but 9 properties such as 'sh1_0'"):  # Houdini's
        read_model(plain_ply([*plain, *(f"sh{k}_{c}" for k in (1, 2, 3) for c in range(3))], ROWS))
    head, _ = plain_ply(plain, ROWS[:, : len(plain)]).split(b"end_header\n")
    rows = np.zeros(40, [("floats", "<f4", len(plain)), ("length", "u1"), ("rest", "<f4", 9)])
    rows["length"] = 9
    with pytest.raises(FormatError, match=r"'f_rest_0': is missing, but 9 properties such as 'f_rest\[0\]'"):
        read_model(head + b"property list uchar float f_rest\nend_header\n" + rows.tobytes())


def test_the_first_version_of_gltf_is_named() -> None:
    with pytest.raises(UnsupportedFormatError, match=r"glTF version '1\.0', read is 2"):
        read_model(b'{"asset": {"version": "1.0"}, "meshes": {}}')


def test_an_element_of_another_name() -> None:
    """Street Gaussians has one for each thing that moves; some scripts one that is called after the Gaussians."""
    whole = plain_ply(NAMES, ROWS)
    loaded = read_model(whole.replace(b"element vertex", b"element gaussian"))
    assert_same(loaded.model, read_model(whole).model)
    assert loaded.repairs[0].text == "element 'gaussian' was read as 'vertex'"
    head, body = whole.replace(b"element vertex", b"element vertex_background").split(b"end_header\n")
    again = head[head.index(b"element") :].replace(b"background", b"obj_001")
    for name in (b"vertex_background", b"vertex"):
        renamed = head.replace(b"vertex_background", name)
        with pytest.raises(UnsupportedFormatError, match=f"2 elements .'{name.decode()}', 'vertex_obj_001'.*a file of"):
            read_model(renamed + again + b"end_header\n" + body + body)


def test_headers_as_others_write_them() -> None:
    whole = plain_ply(NAMES, ROWS)
    plain = read_model(whole).model
    for old, new in (
        (b"property float opacity", b"\ncomment between\nobj_info\n \nproperty float opacity"),
        (b"property float opacity", b"Property Float opacity"),
        (b"element vertex 40", b"ELEMENT vertex 0000040"),
    ):
        assert_same(read_model(whole.replace(old, new)).model, plain)
    name = "scalar_Höhe_à".encode()  # its last byte is a blank of Latin-1
    loaded = read_model(whole.replace(b"float nx", b"float " + name).replace(b"float ny", b"float \xd6l"))
    assert_same(loaded.model, plain)
    written = encode_model(loaded.model, "ply")
    assert b"property float " + name + b"\n" in written
    assert b"property float \xd6l\n" in written  # Latin-1
    assert r"'scalar_Höhe_à', '\udcd6l'" in loaded.repairs[0].text
    assert_same(read_model(written).model, plain)


@pytest.mark.parametrize(("kind", "code"), [("int64", "<i8"), ("uint64", "<u8"), ("bool", "u1")])
def test_properties_of_other_types_are_carried(kind: str, code: str) -> None:
    head, _ = plain_ply([*NAMES, "id"], ROWS).split(b"end_header\n")
    rows = np.empty(len(ROWS), [(name, "<f4") for name in NAMES] + [("id", code)])
    for i, name in enumerate(NAMES):
        rows[name] = ROWS[:, i]
    rows["id"] = np.arange(len(ROWS)) % 2 + (2**62 if code == "<u8" else 0)
    loaded = read_model(head.replace(b"float id", f"{kind} id".encode()) + b"end_header\n" + rows.tobytes())
    again = read_model(encode_model(loaded.model, "ply"))
    for each in (loaded, again):
        assert each.model.carried is not None
        np.testing.assert_array_equal(each.model.carried.columns["id"], rows["id"])


def test_values_between_commas_are_named() -> None:
    head = plain_ply(NAMES, ROWS).split(b"end_header\n")[0].replace(b"binary_little_endian", b"ascii")
    for between, words in ((", ", "separate values by blanks"), (";", "separate values by"), (" ", "decimal points")):
        text = "\n".join(between.join(f"{v:.6f}" for v in row) for row in ROWS)
        text = text if between != " " else text.replace(".", ",")
        with pytest.raises(FormatError, match=words):
            read_model(head + b"end_header\n" + text.encode())


def test_a_gltf_of_a_program_of_windows() -> None:
    parsed, binary = asset_of(splats(9, 0))
    loaded = read_model(b"\xef\xbb\xbf" + gltf_of(parsed, binary))
    assert_same(loaded.model, read_model(glb_of(parsed, binary)).model)


def test_what_another_scene_of_a_gltf_shows_is_named() -> None:
    parsed, binary = asset_of(splats(9, 0), splats(7, 0, 1))
    parsed["scenes"] = [{"nodes": [0]}, {"nodes": [1]}]
    loaded = read_model(glb_of(parsed, binary))
    assert len(loaded.model) == 9
    assert [each.code for each in loaded.repairs] == ["extra_gltf"]
    assert "'1 meshes that its scene does not show'" in loaded.repairs[0].text


def test_the_folder_of_a_training_names_its_model(tmp_path: Path) -> None:
    for number in ("7000", "30000"):
        folder = tmp_path / "point_cloud" / f"iteration_{number}"
        folder.mkdir(parents=True)
        (folder / "point_cloud.ply").write_bytes(b"ply")
    with pytest.raises(UnsupportedFormatError, match=r"such as 'point_cloud/iteration_30000/point_cloud\.ply'"):
        read_model(tmp_path)
    (tmp_path / "export").mkdir()
    with pytest.raises(UnsupportedFormatError, match=r"no unpacked SOG scene$"):
        read_model(tmp_path / "export")
    (tmp_path / "export" / "splat.ply").write_bytes(b"ply")
    with pytest.raises(UnsupportedFormatError, match=r"such as 'splat\.ply'"):
        read_model(tmp_path / "export")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.splatv", b"KG\0\0\x64\0\0\0[{}]" + bytes(range(1, 200)), "moves"),
        ("a.spx", b"spx\1" + bytes(range(1, 200)), "gsbox spx2ply"),
        ("a_pos.bytes", bytes(range(1, 200)), "Unity"),
        ("a.licht", bytes(range(1, 200)), "LichtFeld Studio: export the scene as .ply"),
        ("a.ingp", bytes(range(1, 200)), "export its Gaussians"),
        ("meta.json", b'{"means": {"shape": [9, 3]}, "opacities": {}}', "gsplat's own compression"),
    ],
)
def test_what_to_give_in_place_of_others_files(name: str, content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UnsupportedFormatError, match=words):
        read_model(tmp_path / name)


@pytest.mark.parametrize("draft", ["KHR_gaussian_splatting", "KHR_spz_gaussian_splats_compression"])
def test_gaussians_of_a_draft_are_no_points(draft: str) -> None:
    found = splats(50, 0)
    old = {"POSITION": found["POSITION"], "COLOR_0": np.ones((50, 4), np.float32)}
    old |= {f"_{name}": found[f"KHR_gaussian_splatting:{name}"] for name in ("ROTATION", "SCALE")}
    parsed, binary = asset_of(old)
    parsed["meshes"][0]["primitives"][0]["extensions"] = {draft: {}}
    parsed["asset"]["generator"] = "Obj2Splat 0.3"
    said = r"is of a draft of .*written by 'Obj2Splat 0\.3'.*export" if draft == "KHR_gaussian_splatting" else "draft"
    with pytest.raises(UnsupportedFormatError, match=said):
        read_model(glb_of(parsed, binary))
    assert read_points(glb_of(parsed, binary), file="x") is None


def test_cameras_of_instant_ngp(tmp_path: Path) -> None:
    pose = [[1.0, 0, 0, 3], [0, 1, 0, 4], [0, 0, 1, 5]]
    frames = [{"file_path": "a.png", "transform_matrix": pose}]
    said = {"w": 640, "h": 480, "fl_x": 500, "fl_y": 500, "k1": 0.05, "k2": 0.01, "is_fisheye": True, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(said))
    (camera,) = read_cameras(tmp_path)
    assert isinstance(camera, FisheyeCamera)
    assert camera.bends == (0.05, 0.01, 0.0, 0.0)
    np.testing.assert_allclose(camera.position, [3, 4, 5])


@pytest.mark.parametrize("points", ["", "\n", "1.5 2.5 -1 3 4 17\n"])
def test_every_image_of_a_text_model_is_read(points: str, tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 640 480 500 500 320 240\n")
    images = (f"{k} 1 0 0 0 {k} 0 0 1 image {k}.png\n{points}" for k in range(1, 6))
    (tmp_path / "images.txt").write_text("# Image list with two lines of data per image:\n" + "".join(images))
    assert [camera.position[0] for camera in read_cameras(tmp_path)] == [-1, -2, -3, -4, -5]


def test_a_point_cloud_of_a_training_names_the_model() -> None:
    names = ["x", "y", "z", "nx", "ny", "nz"]
    with pytest.raises(UnsupportedFormatError, match=r"point_cloud/iteration_N/point_cloud\.ply"):
        read_model(plain_ply(names, np.zeros((9, 6))))


@pytest.mark.parametrize("kind", ["float", "int"])
def test_gaussians_that_ride_on_a_mesh_are_no_scene(kind: str) -> None:
    """GaussianAvatars stores each in the frame of its triangle: read as they are, all lie in one heap."""
    whole = plain_ply([*NAMES, "binding_0"], np.hstack([ROWS, np.arange(40)[:, None]]))
    with pytest.raises(UnsupportedFormatError, match=r"'binding_0': the Gaussians ride on a mesh.*export a moment"):
        read_model(whole.replace(b"float binding_0", f"{kind} binding_0".encode()))


@pytest.mark.parametrize("flat", [-30.0, -np.inf])
def test_flat_gaussians_do_not_lie_far_out(flat: float) -> None:
    """Three scales of a 2DGS or PGSR model: how far a center may be rounded follows from the size within the disc."""
    rows = np.zeros((90, len(NAMES)), np.float32)
    rows[:, :3] = np.random.default_rng(0).normal(0, 3, (90, 3))
    rows[:, NAMES.index("scale_0") : NAMES.index("scale_0") + 3] = [-4, -4, flat]
    loaded = read_model(plain_ply(NAMES, rows))
    assert "centers_coarse" not in [each.code for each in loaded.repairs]
    needles = rows.copy()
    needles[:, NAMES.index("scale_1")] = flat
    assert "centers_coarse" not in [each.code for each in read_model(plain_ply(NAMES, needles)).repairs]
    rows[:, 0] += 4e6
    assert "centers_coarse" in [each.code for each in read_model(plain_ply(NAMES, rows)).repairs]


def test_what_a_gltf_hides_is_left_out() -> None:
    """KHR_node_visibility, of a node or of one above it."""
    parsed, binary = asset_of(splats(9, 0), splats(7, 0, 1))
    parsed["nodes"] += [{"children": [1], "extensions": {"KHR_node_visibility": {"visible": False}}}]
    parsed["scenes"] = [{"nodes": [0, 2]}]
    parsed["extensionsRequired"] = ["KHR_node_visibility"]
    loaded = read_model(glb_of(parsed, binary))
    assert len(loaded.model) == 9
    assert "'1 meshes that its scene does not show'" in loaded.repairs[0].text
    parsed["nodes"][2]["extensions"]["KHR_node_visibility"]["visible"] = True
    assert len(read_model(glb_of(parsed, binary)).model) == 16


@pytest.mark.parametrize(
    ("change", "what"), [(lambda data: data[:-9], "cut off"), (lambda d: d + b"\0", "bytes follow")]
)
def test_a_glb_of_another_length(change: Callable[[bytes], bytes], what: str) -> None:
    with pytest.raises(FormatError, match=f"are there: {what}"):
        read_model(change(glb_of(*asset_of(splats(9, 0)))))


def test_a_signalling_nan_among_halves_is_left_out() -> None:
    head, _ = plain_ply(names_of(0), np.zeros((9, 14))).split(b"end_header\n")
    rows = np.zeros(9, [("x", "<u2"), *((name, "<f4") for name in names_of(0)[1:])])
    rows["x"][4] = 0x7D00
    loaded = read_model(head.replace(b"float x", b"half x") + b"end_header\n" + rows.tobytes())
    assert loaded.repairs[0].code == "rows_dropped"
    assert len(loaded.model) == 8
