from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from engine.errors import FormatError
from service.problems import Problem
from service.work import inputs
from service.work.inputs import load_cameras, load_model, load_pictures

CAMERA = {
    "id": 0,
    "img_name": "0",
    "width": 64,
    "height": 48,
    "position": [0, 0, 0],
    "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "fx": 60.0,
    "fy": 60.0,
}


def png_header(width: int, height: int) -> bytes:
    """A PNG that claims a size and holds next to nothing."""
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + struct.pack(">I", 13)
        + body
        + struct.pack(">I", zlib.crc32(body))
        + (struct.pack(">I", 50) + b"IDAT" + zlib.compress(b"\0" * 9))
    )


def small_png(folder: Path, name: str = "good.png") -> Path:
    Image.fromarray(np.zeros((32, 32, 3), np.uint8)).save(folder / name)
    return folder / name


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is no PNG"),
        (b"not a picture at all", "is no PNG"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n", "is no PNG"),
        (b"\x89PNG\r\n\x1a\n garbage", "cannot be read"),
        (b"\xff\xd8\xff\xe0 garbage", "cannot be read"),
        (b"II*\0\xff\xff\xff\xff", "cannot be read"),
        (png_header(9000, 9000), "too large"),
        (png_header(12_000, 12_000), "too large"),
        (png_header(60_000, 60_000), "too many pixels"),
        (png_header(64, 64), "truncated"),
    ],
)
def test_hostile_pictures_are_named_by_number_only(tmp_path: Path, content: bytes, words: str) -> None:
    bad = tmp_path / "secret-place.png"
    bad.write_bytes(content)
    with pytest.raises(Problem) as caught:
        load_pictures([str(small_png(tmp_path)), str(bad)])
    assert caught.value.kind == "unreadable-image"
    assert caught.value.detail.startswith("picture 2: ")
    assert words in caught.value.detail
    assert "secret-place" not in caught.value.detail


def test_a_truncated_picture_is_refused(tmp_path: Path) -> None:
    whole = tmp_path / "whole.jpg"
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (200, 200, 3), np.uint8)).save(whole)
    whole.write_bytes(whole.read_bytes()[:-3000])
    with pytest.raises(Problem, match="picture 1: "):
        load_pictures([str(whole)])


def test_how_many_pictures_go_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = str(small_png(tmp_path))
    assert len(load_pictures([one] * inputs.MOST_PICTURES)) == 64
    for count in (0, 65):
        with pytest.raises(Problem, match=f"got {count}"):
            load_pictures([one] * count)
    monkeypatch.setattr(inputs, "MAX_PIXELS_TOGETHER", 2000)
    with pytest.raises(Problem, match="2,048 pixels together"):
        load_pictures([one] * 2)


def test_cameras_go_with_the_pictures(tmp_path: Path) -> None:
    path = tmp_path / "secret-place.json"
    path.write_text(json.dumps([CAMERA, CAMERA]))
    assert load_cameras(None, count=3) is None
    assert len(load_cameras(str(path), count=2) or ()) == 2
    for content, words in (
        (json.dumps([CAMERA]), "2 pictures, but 1 cameras"),
        (json.dumps([CAMERA, {**CAMERA, "width": 16_000, "height": 16_000}]), "pixels"),
        ("{", "is no JSON"),
        (json.dumps([CAMERA, {**CAMERA, "fx": "wide"}]), "fx"),
    ):
        path.write_text(content)
        with pytest.raises(Problem) as caught:
            load_cameras(str(path), count=2)
        assert caught.value.kind == "unreadable-cameras"
        assert words in caught.value.detail
        assert "secret-place" not in caught.value.detail


def test_a_model_without_gaussians_is_refused(tmp_path: Path) -> None:
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 0\n"
    (tmp_path / "empty.ply").write_text(header + "property float x\nend_header\n")
    with pytest.raises((Problem, FormatError)):
        load_model({"model": str(tmp_path / "empty.ply")})
