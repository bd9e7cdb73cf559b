"""Which reader a file gets, and what is known about the file afterwards."""

from __future__ import annotations

import hashlib
import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import engine.formats
from engine.errors import FormatError, InputError, UnsupportedFormatError
from engine.formats import FORMATS, encode_model, read_model, write_model
from engine.formats.image_files import is_picture
from tests.formats.models import DATA, assert_same, random_model

TRAIN = DATA / "train_1000.ply"


def test_public_names() -> None:
    names = engine.formats.__all__
    assert names == sorted(names)
    assert all(hasattr(engine.formats, name) for name in names)


@pytest.mark.parametrize("format", FORMATS)
def test_the_first_bytes_decide_and_not_the_name(tmp_path: Path, format: str) -> None:
    model = random_model(0, 300)
    data = encode_model(model, format)
    path = tmp_path / ("scene.spz" if format == "ply" else "scene.ply")
    path.write_bytes(data)
    loaded = read_model(path)
    assert loaded.format == format
    assert len(loaded.model) == 300
    assert loaded.source_bytes == len(data)
    assert loaded.sha256 == hashlib.sha256(data).hexdigest()
    for content in (bytearray(data), memoryview(data)):
        assert_same(read_model(content).model, loaded.model)


def test_the_name_is_what_messages_call_the_file() -> None:
    with pytest.raises(FormatError) as caught:
        read_model(b"", name="their.ply")
    assert str(caught.value) == "their.ply: is empty"
    assert caught.value.file == "their.ply"
    with pytest.raises(FormatError, match=r"^\(bytes\): is empty"):
        read_model(b"")


def test_other_formats_are_refused_by_name() -> None:
    with pytest.raises(UnsupportedFormatError, match=r"\.ksplat version 0\.0"):
        read_model(bytes(4095) + b"\1", name="Scene.KSPLAT")
    with pytest.raises(UnsupportedFormatError, match=r"none of the formats read here: .*ply, compressed\.ply, .*spz"):
        read_model(b"hello\0", name="scene.ply")


@pytest.mark.parametrize("ending", ["ply", "ksplat"])
@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b"<!DOCTYPE html><title>404</title>" + b" " * 5000, "is a web page"),
        (b"version https://git-lfs.github.com/spec/v1\nsize 9\n", "git lfs pull"),
        (b'{"error": "not found"}', "is text, no model"),
        (b"\x89PNG\r\n\x1a\n" + bytes(5000), "is a picture, not a model"),
        (b"\0\0\0\x20ftypmif1\0\0\0\0mif1avif" + bytes(5000), "is a picture, not a model"),
        (b"\n" + TRAIN.read_bytes(), "begins like a PLY"),
    ],
)
def test_what_was_saved_under_a_models_name_is_named(content: bytes, what: str, ending: str) -> None:
    with pytest.raises(UnsupportedFormatError, match=what):
        read_model(content, name=f"scene.{ending}")


def test_paths_that_are_no_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.ply: cannot be read: No such file"):
        read_model(tmp_path / "absent.ply")
    with pytest.raises(UnsupportedFormatError, match=r"folder without meta\.json"):
        read_model(tmp_path)
    with pytest.raises(InputError, match="is no file name"):
        read_model("a\0b.ply")
    fifo = tmp_path / "pipe.ply"
    os.mkfifo(fifo)
    with pytest.raises(InputError, match="is no regular file"):
        read_model(fifo)


def test_an_unpacked_sog_scene(tmp_path: Path) -> None:
    import zipfile

    path = tmp_path / "scene.sog"
    write_model(random_model(1, 300), path)
    folder = tmp_path / "scene"
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    packed, unpacked = read_model(path), read_model(folder)
    assert_same(packed.model, unpacked.model)
    assert unpacked.format == "sog"
    assert unpacked.source_bytes == sum(file.stat().st_size for file in folder.iterdir())
    by_meta = read_model(folder / "meta.json")
    assert by_meta.sha256 == unpacked.sha256
    (folder / "notes.txt").write_text("not of the scene")
    assert read_model(folder).sha256 == unpacked.sha256
    image = next(folder.glob("*.webp"))
    image.write_bytes(image.read_bytes() + b"\0")
    assert read_model(folder).sha256 != unpacked.sha256


def test_chains_of_formats_stay_the_same_scene() -> None:
    """Through every format in turn: the geometry moves by no more than the formats round."""
    model = read_model(TRAIN).model
    for format in FORMATS:
        model = read_model(encode_model(model, format)).model
        assert len(model) == 1000
    original = read_model(TRAIN).model
    extent = float(np.ptp(original.means, axis=0).max())
    center = np.abs(model.means.mean(axis=0) - original.means.mean(axis=0)).max()
    assert center < 1e-3 * extent
    np.testing.assert_allclose(np.sort(model.opacities), np.sort(original.opacities), atol=0.02)


@pytest.mark.parametrize(
    ("head", "advice"),
    [
        (b"\0\0\0\x18ftypheic", "HEIC photo: save it as JPEG"),
        (b"\0\0\0\x0cjP  \r\n\x87\n", "save it as PNG"),
        (b"\0\0\0\x20ftypisom", "video: save some of its frames"),
        (b"\x1aE\xdf\xa3\x9fB\x86", "video"),
        (b"RIFF\0\0\0\0AVI LIST", "video"),
        (b"%PDF-1.7\n", "PDF: save the picture"),
        (b"\0\0\0\x18ftypcrx ", "camera's raw file"),
        (b"FUJIFILMCCD-RAW 0201", "camera's raw file"),
        (b"\xabKTX 20\xbb\r\n\x1a\n", "save it as PNG"),
        (b"II+\0\10\0\0\0", "save it as PNG"),
        (b"\n<!DOCTYPE html>\n<html>", "web page: give the model that it loads"),
    ],
)
def test_what_people_hold_for_a_suspect_is_named(head: bytes, advice: str) -> None:
    with pytest.raises(UnsupportedFormatError, match=advice):
        read_model(head + bytes(100))


@pytest.mark.parametrize(
    ("text", "encoding", "advice"),
    [
        ('{"frames": []}', "utf-8-sig", "holds cameras"),
        ("Zugriff verweigert für diese Seite, 東京", "utf-8", "is text, no model"),
        ("<Error><Code>AccessDenied</Code></Error>", "utf-16", "is text, no model.*AccessDenied"),
    ],
)
def test_text_of_any_language_is_named(text: str, encoding: str, advice: str) -> None:
    with pytest.raises(UnsupportedFormatError, match=advice):
        read_model(text.encode(encoding))


def zip_of(*names: str) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name in names:
            archive.writestr(name, bytes(9))
    return file.getvalue()


NOISE = bytes(range(1, 98))


@pytest.mark.parametrize(
    ("data", "name", "what"),
    [
        (zip_of("archive/data.pkl", "archive/version", "archive/data/0"), "x", "PyTorch.*export_splats.*ns-export"),
        (zip_of("ckpt/version", "ckpt/data.pkl"), "step-000029999.ckpt", "PyTorch"),
        (b"\x80\x02\x8a" + NOISE, "chkpnt30000.pth", "PyTorch.*point_cloud.ply"),
        (zip_of("means.npy", "sh.npy"), "splats.npz", "numpy"),
        (b"\x93NUMPY\1\0" + NOISE, "x", "numpy"),
        (b"\x40" + bytes(7) + b'{"means":{}}', "x", "tensors"),
        (b'{"version": "5.0", "totalSplats": 1000, "totalLevel": 5}', "meta", "XGRIDS.*splat-transform FILE"),
        (b'{"version": "5.0"}', "scene.lcc", "XGRIDS"),
        (b'{"tree": {}}', "scene.LCC2", "XGRIDS.*splat-transform FILE"),
        (b"RAD0" + NOISE, "x", "Spark.*splat-transform FILE"),
        (NOISE, "scene.RAD", "Spark"),
        (NOISE, "room.psht", "Postshot.*export the scene as .ply"),
        (b'{"asset": {"version": "1.1"}, "geometricError": 9, "root": {}}', "tileset.json", "3D Tiles"),
        (b'{"version": 2, "means": {"codebook": []}}', "meta.json", "index of a SOG scene"),
        (b'{"camera_angle_x": 0.7, "frames": []}', "transforms.json", "cameras, no Gaussians"),
        (b'[{"id": 0, "rotation": []}]', "cameras.json", "cameras, no Gaussians"),
        (b"!!python/object:nerfstudio.engine.trainer.TrainerConfig\n", "config.yml", "ns-export"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "scene.ply", "git lfs pull"),
        (b"LASF" + NOISE, "x", "is a point cloud"),
        (b"1 2 3 255 0 0\n", "scan.xyz", "is a point cloud"),
        (b"# made by hand\nmtllib a.mtl\nv 1 2 3\n", "x", "is a mesh"),
        (b"v 1.0 2.0 3.0\n", "x", "is a mesh"),
        (b"Kaydara FBX Binary  \0" + NOISE, "x", "is a mesh"),
        (NOISE, "part.STL", "is a mesh"),
        (b"7z\xbc\xaf\x27\x1c" + NOISE, "x", "packed archive"),
        (NOISE, "scene.xyz2", "none of the formats read here: .*ply"),
        (b'{"a": 1}', "x.json", "is text.*begins with '{\"a\": 1}'"),
        ("ply\nformat".encode("utf-16"), "x", "begins like a PLY"),
        (b"\0\5\x16\7" + NOISE, "._scene.ply", "of macOS"),
        (b"%YAML 1.1\n%TAG !u! tag:unity3d.com,2011:\n", "scene.asset", "Unity.*the .ply"),
        (b"\xc1\x83\x2a\x9e" + NOISE, "x", "Unreal"),
        (bytes(5000), "scene.ply", "nothing but zeros"),
        (NOISE, "sparse/0/points3D.bin", "is a point cloud"),
        (b"\x04\x22\x4d\x18" + NOISE, "x", "packed archive"),
        (b"v/1\1" + NOISE, "x", "save it as PNG"),
        (b"II\xbc\1" + NOISE, "x", "save it as PNG"),
        (b"P6\n2 2\n255\n" + NOISE, "x", "save it as PNG"),
        (b"\xef\xbb\xbf<!DOCTYPE html>", "x", "web page"),
    ],
)
def test_what_is_no_model_is_named_with_what_to_give(data: bytes, name: str, what: str) -> None:
    with pytest.raises(UnsupportedFormatError, match=what):
        read_model(data, name=name)


@pytest.mark.parametrize(("data", "name"), [(b"PXR-USDC" + NOISE, "x"), (zip_of("scene.usdc"), "scene.usdz")])
def test_damaged_scenes_are_named_whether_their_library_is_there_or_not(data: bytes, name: str) -> None:
    with pytest.raises(FormatError, match="OpenUSD"):
        read_model(data, name=name)


@pytest.mark.parametrize("cut", [1, 7, 31])
def test_a_splat_that_is_cut_off_is_named_as_one(cut: int) -> None:
    for name in ("scan.splat", "upload"):
        with pytest.raises(FormatError, match="no multiple of 32 bytes: cut off") as caught:
            read_model(encode_model(random_model(0, 200), "splat")[:-cut], name=name)
        assert caught.value.row == 199


@pytest.mark.parametrize("kind", ["ply", "spz", "splat", "glb"])
@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("line ends", lambda data: data.replace(b"\n", b"\r\n")),
        ("characters", lambda data: data.decode("utf-8", "replace").encode()),
    ],
)
def test_a_transfer_as_text_is_named(kind: str, what: str, change: Callable[[bytes], bytes]) -> None:
    with pytest.raises(FormatError, match=f"its {what} were changed.*again, as binary"):
        read_model(change(encode_model(random_model(0, 3000), kind)), name="scene." + kind)


@pytest.mark.parametrize("address", ["https://superspl.at/scene?id=1", "s3://bucket/a.ply", "file:///tmp/no.ply"])
def test_an_address_is_no_file(address: str) -> None:
    for read in (read_model, is_picture):
        with pytest.raises(InputError, match="is an address: download the file"):
            read(Path(address))
    with pytest.raises(InputError, match=r"C:/no\.ply: cannot be read: No such file"):
        read_model("C:/no.ply")
