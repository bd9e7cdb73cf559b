"""Models inside gzip and zip archives, as shops, platforms and mail programs send them."""

from __future__ import annotations

import gzip
import io
import json
import tempfile
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats import encode_model, read_model, wrappings
from engine.formats.gltf.metadata import Metadata, annotate_glb, read_metadata
from engine.model import SH_C0
from engine.scenes.scene_files import read_suspect
from tests.formats.damage import little_memory
from tests.formats.gltf_files import asset_of, glb_of, splats
from tests.formats.models import assert_same, random_model
from tests.formats.sog_scenes import bundle, unbundle
from tests.formats.spz_scenes import as_version_4

MODEL = random_model(1, 300)
KINDS = ("ply", "compressed.ply", "splat", "spz", "sog", "glb")
JUNK = {"Scan/": b"", "Scan/read me.txt": b"a scan", "__MACOSX/Scan/._scène.ply": b"\0\5\x16\7", "Scan/.a.ply": b"ply"}


zip_of = partial(bundle, compression=zipfile.ZIP_DEFLATED)


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_in_gzip_or_zip_is_read(kind: str) -> None:
    data = as_version_4(encode_model(MODEL, kind)) if kind == "spz" else encode_model(MODEL, kind)
    plain = read_model(data)
    in_zip = zip_of({f"Scan/scène.{kind.upper()}": data, **JUNK})
    for packed, said in (
        (gzip.compress(data), "unpacked first (gzip)"),
        (gzip.compress(data) + bytes(512), "unpacked first (gzip)"),  # padded, as on tapes
        (gzip.compress(data[:50]) + gzip.compress(data[50:]), "unpacked first (gzip)"),  # in parts, as bgzip
        (in_zip, f"unpacked first ('Scan/scène.{kind.upper()}')"),
        (gzip.compress(in_zip), f"unpacked first ('Scan/scène.{kind.upper()}')"),
    ):
        loaded = read_model(packed, name="upload")
        assert_same(loaded.model, plain.model)
        assert (loaded.format, loaded.source_bytes) == (kind, len(packed))
        assert (loaded.repairs[0].code, loaded.repairs[0].text) == ("unwrapped", said)
        assert loaded.repairs[1:] == plain.repairs


def test_formats_that_are_archives_themselves_are_no_wrapping() -> None:
    for kind in ("spz", "sog"):
        assert "unwrapped" not in [each.code for each in read_model(encode_model(MODEL, kind)).repairs]
    scene = unbundle(encode_model(MODEL, "sog"))
    assert read_model(zip_of(scene | {"first.ply": b"ply"})).format == "sog"


@pytest.mark.parametrize("name", ["meta.json", "Scan/meta.json", "scene_meta.json"])
def test_a_meta_json_beside_a_model_may_be_anybodys(name: str) -> None:
    """Platforms put what they know of a scan into one."""
    loaded = read_model(zip_of({"Scan/scene.ply": encode_model(MODEL, "ply"), name: b'{"title": "scan"}'}))
    assert (loaded.format, loaded.repairs[0].code) == ("ply", "unwrapped")


def test_a_damaged_archive_is_no_archive_without_a_model() -> None:
    whole, twice = zip_of({"scene.ply": encode_model(MODEL, "ply")}), io.BytesIO()
    with zipfile.ZipFile(twice, "w") as archive:
        archive.writestr("scene.ply", b"ply")
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("scene.ply", b"ply")
    photos = {f"photos/{i:060}.jpg": b"" for i in range(700)}
    for data, what in (
        (whole[:-30], "its end is cut off"),
        (twice.getvalue(), "two entries of this name: unpack it"),
        (zip_of(photos | {"scene.ply": b"ply"}), "far more entries than a scene has: unpack it"),
    ):
        with pytest.raises(FormatError, match=what):
            read_model(data)


def test_a_gltf_in_an_archive_may_name_what_lies_in_it() -> None:
    parsed, binary = asset_of(splats(40, 1))
    beside = json.dumps(parsed | {"buffers": [{"byteLength": len(binary), "uri": "bin/scene%201.bin"}]}).encode()
    packed = zip_of({"a/": b"", "a/scene.gltf": beside, "a/bin/scene 1.bin": binary, "license.txt": b"CC-BY"})
    loaded = read_model(packed, name="of another user")
    assert_same(loaded.model, read_model(glb_of(parsed, binary)).model)
    with pytest.raises(FormatError, match=r"'a/scene\.gltf': names 'bin/scene 1\.bin', which is not beside it"):
        read_model(zip_of({"a/scene.gltf": beside, "../a/bin/scene 1.bin": binary, "scene 1.bin": binary}))
    with pytest.raises(FormatError, match="cannot be unpacked"):
        read_model(zip_of({"a/scene.gltf": beside, "a/bin": b"", "a/bin/scene 1.bin": binary}))


def test_nothing_is_written_beyond_the_archive(tmp_path: Path) -> None:
    parsed, binary = asset_of(splats(9, 0))
    beside = json.dumps(parsed | {"buffers": [{"byteLength": len(binary), "uri": "a.bin"}]}).encode()
    absolute, above = tmp_path / "written", f"written-{tmp_path.parent.name}-{tmp_path.name}"
    loaded = read_model(zip_of({str(absolute): b"x", f"../{above}": b"x", "a.gltf": beside, "a.bin": binary}))
    assert len(loaded.model) == 9
    assert not absolute.exists()
    assert not Path(tempfile.gettempdir(), above).exists()
    with pytest.raises(UnsupportedFormatError, match="without a model in it"):
        read_model(zip_of({"/a.ply": b"", "C:/a.ply": b"", "../a.ply": b""}))


def test_a_textured_mesh_in_an_archive_is_a_suspect(tmp_path: Path) -> None:
    picture = io.BytesIO()
    Image.new("RGB", (2, 2), (51, 102, 204)).save(picture, "PNG")
    lines = ["mtllib m.mtl", *(f"v {i} {i * i} 0" for i in range(6)), "vt 0.5 0.5", "usemtl a", "f 1/1 2/1 3/1"]
    parts = {"m.obj": "\n".join([*lines, "f 4/1 5/1 6/1"]).encode(), "m.mtl": b"newmtl a\nmap_Kd t.png"}
    (tmp_path / "scan.zip").write_bytes(zip_of(parts | {"t.png": picture.getvalue()}))
    for name in (None, "of another user"):
        found = read_suspect(tmp_path / "scan.zip", name=name)
        assert found.format == "points"
        np.testing.assert_allclose(0.5 + SH_C0 * found.model.sh[:, 0], [[0.2, 0.4, 0.8]] * 6, atol=0.01)


def test_several_models_are_named() -> None:
    with pytest.raises(UnsupportedFormatError, match=r"2 models \('a/1\.ply', 'b\.spz'\): unpack it, and give one"):
        read_model(zip_of({"a/1.ply": b"", "b.spz": b"", "c.txt": b""}))
    with pytest.raises(UnsupportedFormatError, match=r"without a model in it \(\.ply"):
        read_model(zip_of({"photo.jpg": b"\xff\xd8\xff"}))
    with pytest.raises(UnsupportedFormatError, match="PyTorch checkpoint"):  # of more entries than a scene has
        read_model(zip_of({"a/data.pkl": b"", "a/a.ply": b""} | {f"a/data/tensor-{k:040}": b"" for k in range(900)}))


def test_what_is_wrong_inside_is_said_of_it() -> None:
    with pytest.raises(FormatError, match=r"x\.zip, 'Scan/a\.ply': the header is cut off"):
        read_model(zip_of({"Scan/a.ply": b"ply\n"}), name="x.zip")
    with pytest.raises(UnsupportedFormatError, match=r"x\.tgz: is a packed archive"):
        read_model(gzip.compress(bytes(257) + b"ustar" + bytes(250)), name="x.tgz")
    with pytest.raises(FormatError, match="damaged gzip stream"):
        read_model(gzip.compress(encode_model(MODEL, "ply"))[:-9])
    with pytest.raises(FormatError, match="encrypted, or neither stored nor deflated: unpack the archive"):
        read_model(bundle({"a.ply": encode_model(MODEL, "ply")}, zipfile.ZIP_LZMA))


@pytest.mark.parametrize("wrap", [gzip.compress, lambda data: zip_of({"a.ply": data})])
def test_bombs_are_refused(wrap, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wrappings, "_FREE_BYTES", 1 << 20)
    bomb = wrap(b"ply\n" + bytes(16 << 20))
    with little_memory(8 << 20), pytest.raises(FormatError, match=r"to more than 1,048,576 bytes|at most 1048576"):
        read_model(bomb)


def test_archives_are_bounded_as_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wrappings, "_FREE_BYTES", 1 << 20)
    with little_memory(8 << 20), pytest.raises(FormatError, match="at most"):
        read_model(zip_of({"a.gltf": b"{}"} | {f"{k}.bin": bytes(1 << 19) for k in range(4)}))


@pytest.mark.parametrize("start", [b"\x1f\x8b\x08\x00", b"PK\x03\x04"])
def test_a_splat_may_begin_as_an_archive(start: bytes) -> None:
    data = start + encode_model(MODEL, "splat")[4:]
    assert read_model(data).format == "splat"


@pytest.mark.parametrize("wrap", [gzip.compress, lambda data: zip_of({"a.glb": data})])
def test_rights_are_read_inside(wrap) -> None:
    data = b"".join(annotate_glb(encode_model(MODEL, "glb"), Metadata("(c) Jo")))
    assert read_metadata(wrap(data), file="x") == Metadata("(c) Jo")
