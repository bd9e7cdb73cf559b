"""Pictures in a form: decided by their headers, all in one process."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import numpy as np
import pytest
from PIL import Image

from service.processes import run_once
from service.uploads import ingest
from tests.service.api.conftest import Api


def picture(number: int, kind: str = "PNG", size: tuple[int, int] = (40, 30), **options: Any) -> bytes:
    file = io.BytesIO()
    levels = np.random.default_rng(number).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    Image.fromarray(levels).save(file, kind, **options)
    return file.getvalue()


def huge(width: int) -> bytes:
    """The start of a PNG, `width` by 8000."""
    data = bytearray(picture(0))
    data[16:24] = struct.pack(">II", width, 8000)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return bytes(data)


def send(api: Api, pictures: list[bytes]) -> Any:
    return api.client.post("/v1/verify", files=[("images", (f"{i}.png", data)) for i, data in enumerate(pictures)])


def test_64_in_one_form(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    tasks: list[str] = []

    def look(settings: Any, task: str, *rest: Any) -> Any:
        tasks.append(task)
        return run_once(settings, task, *rest)

    monkeypatch.setattr(ingest, "run_once", look)
    cut = picture(63)[:2000]  # of which only decoding tells
    answer = send(api, [picture(number) for number in range(63)] + [cut])
    assert answer.status_code == 202, answer.text
    assert tasks == ["pictures"]
    kept = api.client.get("/v1/uploads", params={"limit": 100}).json()["items"]
    assert [upload["info"] for upload in kept] == [{"kind": "picture", "width": 40, "height": 30}] * 64


@pytest.mark.parametrize(
    ("bad", "text"), [(b"\x89PNG\r\n\x1a\nnothing", "picture 2: "), (huge(8001), "picture 2: 8001x8000 pixels")]
)
def test_one_that_is_none_is_named_and_none_is_kept(api: Api, bad: bytes, text: str) -> None:
    answer = send(api, [picture(1), bad, picture(2)])
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:mark3dgs:problem:unreadable-image")
    assert text in answer.json()["detail"]
    assert api.client.get("/v1/uploads").json()["items"] == []


def test_too_many_pixels_together(api: Api) -> None:
    large = huge(7999)
    answer = send(api, [large] * 4)
    assert "255,968,000 pixels together" in answer.json()["detail"]


def test_too_many_pixels_of_uploads(api: Api) -> None:
    slots = [api.upload(huge(7999), "a.png") for _ in range(4)]
    answer = api.client.post("/v1/verify", json={"image_upload_ids": slots})
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:mark3dgs:problem:unreadable-image")


def test_a_photograph_that_lies_on_its_side(api: Api) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    slot = api.upload(picture(1, "JPEG", exif=exif), "a.jpg")
    info = api.client.get(f"/v1/uploads/{slot}").json()["info"]
    assert (info["width"], info["height"]) == (30, 40)
