"""glTF with KHR_gaussian_splatting: the specification row by row, what others write, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats import encode_model, read_model
from engine.formats.gltf.container import unpack
from engine.formats.gltf.scene import looks_like_gltf
from engine.model import Camera, GaussianModel, look_at
from engine.numerics.image_metrics import psnr
from engine.numerics.similarity import transform_model
from engine.raster import render, sh_colors
from tests.formats.gltf_files import EXTENSION, asset_of, glb_of, gltf_of, read_slowly, splats
from tests.formats.models import assert_same, random_model

FLIP = np.diag([-1.0, -1.0, 1.0])


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_what_is_written_is_what_the_specification_says(degree: int) -> None:
    """Values in glTF's own terms, and colours seen from glTF's own directions by the specification's formulas."""
    model = random_model(degree, 50)
    data = encode_model(model, "glb")
    found = {name: np.array(rows) for name, rows in read_slowly(data).items()}
    np.testing.assert_array_equal(found["POSITION"], model.means * np.float32([-1, -1, 1]))
    np.testing.assert_allclose(found[f"{EXTENSION}:SCALE"], np.exp(model.log_scales), rtol=1e-6)
    np.testing.assert_allclose(found[f"{EXTENSION}:OPACITY"][:, 0], model.opacities, rtol=1e-6)
    theirs = Rotation.from_quat(found[f"{EXTENSION}:ROTATION"]).as_matrix()  # x, y, z, w
    ours = Rotation.from_quat(model.quats[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(theirs @ FLIP, FLIP @ ours @ FLIP @ FLIP, atol=1e-6)
    x, y, z = direction = np.array([0.36, 0.48, 0.8])
    c1, c2 = 0.4886025119029199, (1.092548430592079, 0.3153915652525200, 0.5462742152960395)
    c3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644657, 0.3731763325901154, 1.445305721320277)
    basis = [0.2820947917738781, -c1 * y, c1 * z, -c1 * x]
    basis += [c2[0] * x * y, -c2[0] * y * z, c2[1] * (2 * z * z - x * x - y * y), -c2[0] * x * z]
    basis += [c2[2] * (x * x - y * y), -c3[0] * y * (3 * x * x - y * y), c3[1] * x * y * z]
    basis += [-c3[2] * y * (4 * z * z - x * x - y * y), c3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y)]
    basis += [-c3[2] * x * (4 * z * z - x * x - y * y), c3[4] * z * (x * x - y * y), -c3[0] * x * (x * x - 3 * y * y)]
    names = [f"{EXTENSION}:SH_DEGREE_{band}_COEF_{m}" for band in range(degree + 1) for m in range(2 * band + 1)]
    colors = 0.5 + sum(b * found[name] for b, name in zip(basis, names, strict=False))
    eye = model.means.mean(axis=0) - 1e6 * (FLIP @ direction)
    np.testing.assert_allclose(sh_colors(model.sh, model.means, eye), np.maximum(colors, 0), atol=1e-4)


@pytest.mark.parametrize("degree", [0, 3])
def test_there_and_back(degree: int) -> None:
    model = random_model(degree)
    loaded = read_model(encode_model(model, "glb"))
    assert (loaded.format, loaded.repairs) == ("glb", ())
    for name in ("means", "quats", "sh"):
        np.testing.assert_array_equal(getattr(loaded.model, name), getattr(model, name))
    np.testing.assert_allclose(loaded.model.log_scales, model.log_scales, atol=2e-7)
    np.testing.assert_allclose(loaded.model.opacity_logits, model.opacity_logits, atol=2e-5)


def test_text_with_its_buffer_inside_is_the_same() -> None:
    parsed, binary = asset_of(splats(40, 2))
    packed, text = read_model(glb_of(parsed, binary)), read_model(gltf_of(parsed, binary), name="scene.gltf")
    assert_same(packed.model, text.model)
    away = json.dumps(parsed | {"buffers": [{"byteLength": len(binary), "uri": "scene.bin"}]}).encode()
    with pytest.raises(UnsupportedFormatError, match=r"another file \('scene\.bin'\)"):
        read_model(away)


def test_the_buffers_of_a_gltf_may_lie_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A glTF as most programs export it; one that comes over the network opens no file."""
    parsed, binary = asset_of(splats(200, 1), splats(100, 1, 1))
    whole = read_model(glb_of(parsed, binary))
    (tmp_path / "my scene").mkdir()
    (tmp_path / "my scene" / "büffer.bin").write_bytes(binary)
    parsed["buffers"][0]["uri"] = "my%20scene/b%C3%BCffer.bin"
    path = tmp_path / "scene.gltf"
    path.write_text(json.dumps(parsed))
    loaded = read_model(path)
    assert_same(loaded.model, whole.model)
    assert (loaded.format, loaded.repairs) == ("glb", ())
    assert loaded.source_bytes == path.stat().st_size + len(binary)
    with monkeypatch.context() as patch:  # what may be allocated follows from all bytes, not from those of the JSON
        patch.setattr("engine.formats.guards.FREE_COUNT", 0)
        patch.setattr("engine.formats.guards.GAUSSIANS_PER_BYTE", 250 / path.stat().st_size)
        assert len(read_model(path).model) == 300
    (tmp_path / "my scene" / "büffer.bin").write_bytes(binary[:-4] + bytes(4))
    assert read_model(path).sha256 != loaded.sha256
    with pytest.raises(UnsupportedFormatError, match=r"in another file .*\.bin'\): give the scene as one file, \.glb"):
        read_model(path, name="upload.gltf")
    (tmp_path / "my scene" / "büffer.bin").unlink()
    with pytest.raises(FormatError, match="not beside it"):
        read_model(path)


def test_degree_four_is_read_to_degree_three() -> None:
    attributes = splats(20, 4)
    loaded = read_model(glb_of(*asset_of(attributes)))
    assert {repair.code for repair in loaded.repairs} - {"quaternions_normalized"} == {"degree_dropped"}
    third = {name: values for name, values in attributes.items() if "SH_DEGREE_4" not in name}
    assert_same(loaded.model, read_model(glb_of(*asset_of(third))).model)


def test_a_signalling_nan_drops_its_row_without_a_warning() -> None:
    attributes = splats(20, 1)
    attributes["POSITION"].view(np.uint32)[3, 0] = 0x7F800001
    loaded = read_model(glb_of(*asset_of(attributes)))
    assert len(loaded.model) == 19
    assert "rows_dropped" in {repair.code for repair in loaded.repairs}


def test_integers_are_what_their_accessors_say() -> None:
    """KHR_gaussian_splatting's own table of component types, and strides between rows."""
    plain = splats(60, 0)
    small = dict(plain)
    quats, scales = plain[f"{EXTENSION}:ROTATION"], plain[f"{EXTENSION}:SCALE"].clip(0, 1)
    small[f"{EXTENSION}:ROTATION"] = np.round(quats * 32767).astype("<i2")
    small[f"{EXTENSION}:OPACITY"] = np.round(plain[f"{EXTENSION}:OPACITY"] * 255).astype("u1")
    small[f"{EXTENSION}:SCALE"] = np.round(scales * 65535).astype("<u2")
    parsed, binary = asset_of(small)
    parsed["accessors"][2]["normalized"] = True
    model, expected = read_model(glb_of(parsed, binary)).model, read_model(glb_of(*asset_of(plain))).model
    np.testing.assert_allclose(model.quats, expected.quats, atol=2e-4)
    np.testing.assert_allclose(model.opacities, expected.opacities, atol=0.51 / 255)
    np.testing.assert_allclose(model.scales, expected.scales.clip(0, 1), atol=0.51 / 65535)
    wide = np.zeros((60, 5), np.float32)
    wide[:, 1:4] = plain["POSITION"]
    parsed, binary = asset_of(plain)
    parsed["bufferViews"][0] = {"buffer": 0, "byteOffset": len(binary), "byteLength": wide.nbytes, "byteStride": 20}
    parsed["accessors"][0]["byteOffset"] = 4
    parsed["buffers"][0]["byteLength"] += wide.nbytes
    assert_same(read_model(glb_of(parsed, binary + wide.tobytes())).model, expected)


def test_nodes_place_what_they_show() -> None:
    """Two primitives under nodes in each other, one of them shown twice, against moving the Gaussians ourselves."""
    one, two = splats(30, 2), splats(20, 0, seed=1)
    parsed, binary = asset_of(one, two)
    turn = Rotation.from_euler("xyz", [20, -30, 50], degrees=True)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = 2.0 * Rotation.from_euler("z", 90, degrees=True).as_matrix(), (1, 2, 3)
    parsed["nodes"] = [
        {"children": [1, 2], "rotation": turn.as_quat().tolist(), "scale": [0.5] * 3, "translation": [4, 0, -1]},
        {"mesh": 0},
        {"mesh": 0, "matrix": matrix.T.ravel().tolist()},
        {"mesh": 1},
    ]
    parsed["scenes"] = [{"nodes": [0, 3]}]
    model = read_model(glb_of(parsed, binary)).model
    alone, other = (read_model(glb_of(*asset_of(part))).model for part in (one, two))

    def moved(part: GaussianModel, *steps: tuple[float, Any, Any]) -> GaussianModel:
        for scale, R, t in steps:
            part = transform_model(part, scale, FLIP @ R @ FLIP, FLIP @ np.array(t))
        return part

    outer = (0.5, turn.as_matrix(), (4.0, 0.0, -1.0))
    inner = (2.0, Rotation.from_euler("z", 90, degrees=True).as_matrix(), (1.0, 2.0, 3.0))
    expected = [moved(alone, outer), moved(alone, inner, outer), other]
    assert len(model) == 80
    np.testing.assert_allclose(model.means, np.concatenate([part.means for part in expected]), atol=1e-5)
    np.testing.assert_allclose(model.log_scales, np.concatenate([part.log_scales for part in expected]), atol=1e-5)
    np.testing.assert_allclose(model.sh[:60], np.concatenate([part.sh for part in expected[:2]]), atol=1e-5)
    assert not model.sh[60:, 1:].any()


def test_sizes_that_were_stored_as_logarithms() -> None:
    """splat-transform's writer did so for a while; no other writer's negative sizes are taken for that."""
    parsed, binary = asset_of(splats(40, 0) | {f"{EXTENSION}:SCALE": np.full((40, 3), -3.0, np.float32)})
    parsed["asset"]["generator"] = "splat-transform 1.8.0"
    loaded = read_model(glb_of(parsed, binary))
    np.testing.assert_allclose(loaded.model.log_scales, -3.0)
    assert [repair.code for repair in loaded.repairs] == ["scales_logarithmic"]
    parsed["asset"]["generator"] = "somebody"
    with pytest.raises(FormatError):
        read_model(glb_of(parsed, binary))


def test_a_glb_shows_what_the_ply_shows() -> None:
    model = random_model(2, 300)
    view: Camera = look_at((0, 0, -4), (0, 0, 0), (0, -1, 0), 120.0, 96, 96)
    back = read_model(encode_model(model, "glb")).model
    np.testing.assert_allclose(render(back, view), render(model, view), atol=2e-4)


def spz_tile(model: GaussianModel, said: dict[str, Any], **changes: Any) -> bytes:
    """A GLB around an SPZ file: what a tile of 3D Tiles is; its accessors are placeholders."""
    spz = encode_model(model, "spz")
    parsed, _ = asset_of(splats(5, 0), **changes)
    nested = {"extensions": {f"{EXTENSION}_compression_spz_2": {"bufferView": 0}}}
    primitive = {"attributes": {"POSITION": 0}, "mode": 0, "extensions": {EXTENSION: said | nested}}
    parsed |= {"meshes": [{"primitives": [primitive]}], "buffers": [{"byteLength": len(spz)}]}
    parsed["bufferViews"] = [{"buffer": 0, "byteLength": len(spz)}]
    parsed["accessors"] = [{"componentType": 5126, "count": len(model), "type": "VEC3"}]
    parsed["extensionsRequired"] = [EXTENSION, f"{EXTENSION}_compression_spz_2"]
    return glb_of(parsed, spz + bytes(-len(spz) % 4))


@pytest.mark.parametrize("tile", ["as the draft says", "as Cesium stores it"])
def test_a_tile_shows_what_the_uncompressed_file_shows(tile: str) -> None:
    """Under a node that turns and moves it: its axes must be glTF's by then."""
    model = random_model(2, 300)
    node = {"mesh": 0, "rotation": [0.0, 0.6, 0.0, 0.8], "translation": [1.0, 2.0, 3.0]}
    asset = unpack(encode_model(read_model(encode_model(model, "spz")).model, "glb"), file="")
    plain = read_model(glb_of({**asset.json, "nodes": [node]}, bytes(asset.binary))).model
    if tile == "as the draft says":
        stored, said = model, {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    else:  # what the encoder turns into its axes then stands there as glTF's
        stored, said = transform_model(model, 1.0, np.diag([-1.0, 1.0, -1.0]), np.zeros(3)), {}
    found = read_model(spz_tile(stored, said, nodes=[node]))
    assert (found.format, found.repairs) == ("glb", ())
    for name in ("means", "log_scales", "opacity_logits"):
        np.testing.assert_allclose(getattr(found.model, name), getattr(plain, name), atol=1e-4)
    view = look_at((0, 0, -4), (0, 0, 0), (0, -1, 0), 120.0, 96, 96)
    assert psnr(render(found.model, view), render(plain, view)) > 45


def test_a_tile_on_the_globe_keeps_its_precision() -> None:
    """Earth-centered coordinates: float32 would round to half a unit. All tiles share one origin."""
    places = np.array(
        [[1_331_234.25, -4_655_123.5, 4_136_789.75], [1_331_236.75, -4_655_123.5, 4_136_789.75], [0, 0, 0]]
    )
    parsed, binary = asset_of(splats(30, 1), splats(20, 1, 1), splats(10, 1, 2))
    near = read_model(glb_of(parsed, binary)).model
    parsed["nodes"] = [{"mesh": k, "translation": place.tolist()} for k, place in enumerate(places)]
    far = read_model(glb_of(parsed, binary))
    assert [each.code for each in far.repairs] == ["origin_moved"]
    apart = far.model.means + np.array(far.model.origin) - near.means
    apart -= np.repeat(places * [-1, -1, 1], [30, 20, 10], axis=0)
    assert np.abs(apart[:50]).max() < 1e-5
    assert np.abs(apart[50:]).max() < 1.0


def test_a_tile_whose_bytes_are_elsewhere_is_refused() -> None:
    whole = spz_tile(random_model(1, 30), {})
    for before, after in ((b'"bufferView": 0}', b'"bufferVieu": 0}'), (b'"bufferView": 0}', b'"bufferView": 7}')):
        with pytest.raises(FormatError, match="leads nowhere"):
            read_model(whole.replace(before, after, 1))
    with pytest.raises(FormatError, match="ends at byte"):
        read_model(whole.replace(b'"byteLength": ', b'"byteLength":9', 2))


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_a_damaged_tile_is_an_error_of_ours_or_a_model(data: st.DataObject) -> None:
    whole = bytearray(spz_tile(random_model(1, 20), {}))
    at = data.draw(st.integers(0, len(whole) - 1))
    if data.draw(st.booleans()):
        del whole[at:]
    else:
        new = data.draw(st.binary(min_size=1, max_size=8))
        whole[at : at + len(new)] = new
    try:
        found = len(read_model(bytes(whole), name="tile.glb").model)
    except FormatError as error:
        found = len(error.message)
    assert found > 0


def said(**changes: Any) -> bytes:
    parsed, binary = asset_of(splats(5, 0))
    parsed["meshes"][0]["primitives"][0]["extensions"][EXTENSION] |= changes
    return glb_of(parsed, binary)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (said(kernel="ellipse2d"), "'ellipse2d' is not read here, only 'ellipse'"),
        (said(colorSpace="lin_rec709_display"), "'lin_rec709_display' is not read here"),
        (said(projection="orthographic"), "'orthographic' is not read here"),
        (said(extensions={f"{EXTENSION}_lgsc": {}}), "lgsc'.*not settled"),
        (glb_of(*asset_of(splats(5, 0), extensionsRequired=["EXT_meshopt_compression"])), "EXT_meshopt_compression"),
        (glb_of(*asset_of(splats(5, 0), nodes=[{"mesh": 0, "scale": [1, 2, 1]}])), "stretches"),
        (glb_of(*asset_of(splats(5, 0), nodes=[{"mesh": 0, "scale": [-1, 1, 1]}])), "mirrors"),
        (glb_of({"asset": {"version": "2.0"}, "meshes": [{"primitives": [{"attributes": {}}]}]}, b""), "no Gaussians"),
        (b"glTF\1\0\0\0" + bytes(60), "glTF version 1"),
    ],
)
def test_what_has_no_place_here_is_refused_by_name(data: bytes, what: str) -> None:
    with pytest.raises(UnsupportedFormatError, match=what):
        read_model(data, name="scene.glb")


def test_it_is_told_by_its_first_bytes() -> None:
    assert looks_like_gltf(encode_model(random_model(0, 10), "glb"))
    assert looks_like_gltf(b' {"asset": {"version": "2.0"}}')
    assert looks_like_gltf(b'{"asset": {"version": "2.0"}, "nodes": [')  # cut off: its reader says so
    for other in (
        b"{}",
        b'{"asset": {}}',
        b'{"version": "5.0"}',
        b'{"asset": {"version": "1.1"}, "geometricError": 1}',
    ):
        assert not looks_like_gltf(other)
    for seed in range(300):
        noise = np.random.default_rng(seed).bytes(2000)
        assert not looks_like_gltf(b"{" + noise)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({}, []),
        ({"animations": [{}]}, ["animations"]),
        ({"cameras": [{}], "skins": [{}]}, ["cameras", "skins"]),
        ({"asset": {"version": "2.0", "generator": "x", "copyright": "(c) A"}}, ["copyright"]),
        ({"extensionsUsed": [EXTENSION, "EXT_mesh_gpu_instancing"]}, ["EXT_mesh_gpu_instancing"]),
    ],
)
def test_what_is_no_gaussian_of_a_scene_is_named(change: dict[str, Any], names: list[str]) -> None:
    parsed, binary = asset_of(splats(9, 0))
    told = [each.text for each in read_model(glb_of(parsed | change, binary)).repairs if each.code == "extra_gltf"]
    assert [all(repr(name) in text for name in names) for text in told] == [True] * bool(names)


def test_meshes_attributes_and_targets_beside_gaussians_are_named() -> None:
    parsed, binary = asset_of(splats(9, 0))
    gaussians = parsed["meshes"][0]["primitives"][0]
    gaussians["targets"] = [{"POSITION": 0}]
    gaussians["attributes"]["_LABEL"] = 0
    parsed["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}})
    (told,) = (each.text for each in read_model(glb_of(parsed, binary)).repairs)
    assert all(name in told for name in ("'1 meshes or points without Gaussians'", "'_LABEL'", "'targets'"))


def test_an_accessor_of_zeros_without_bytes_is_named() -> None:
    parsed, binary = asset_of(splats(9, 0))
    del parsed["accessors"][1]["bufferView"]
    with pytest.raises(UnsupportedFormatError, match="no bufferView"):
        read_model(glb_of(parsed, binary))
