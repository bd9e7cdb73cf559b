"""Uploads: streamed, hashed, resumable, limited, inspected."""

from __future__ import annotations

import hashlib
import io
import itertools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import sqlalchemy as sa
from PIL import Image

from engine.errors import UnsupportedFormatError
from service.db.schema import jobs
from service.uploads import ingest
from service.work.inputs import load_model
from tests.formats.gltf_files import asset_of, gltf_of, splats
from tests.service.api.conftest import PLANT, SMALL, Api


def flip(path: Path) -> None:
    """Change a bit."""
    data = bytearray(path.read_bytes())
    data[1000] ^= 1
    path.write_bytes(data)


def test_a_whole_file_in_one_request(api: Api) -> None:
    data = SMALL.read_bytes()
    made = api.client.post("/v1/uploads", json={"name": "a.ply", "size": len(data)})
    assert made.status_code == 201
    assert made.headers["location"] == f"/v1/uploads/{made.json()['id']}"
    done = api.client.put(made.headers["location"], content=data).json()
    assert done["state"] == "complete"
    assert done["sha256"] == hashlib.sha256(data).hexdigest()
    assert done["info"]["format"] == "ply"
    assert done["info"]["gaussians"] == 1000


def test_in_three_parts(api: Api) -> None:
    """A broken connection costs what was on the way: `offset` says where to continue."""
    data = PLANT.read_bytes()
    slot = api.client.post("/v1/uploads", json={"size": len(data)}).json()["id"]
    cuts = [0, 1_000_000, 2_500_000, len(data)]
    for low, high in itertools.pairwise(cuts):
        assert api.client.get(f"/v1/uploads/{slot}").json()["offset"] == low
        answer = api.client.put(f"/v1/uploads/{slot}", content=data[low:high], headers={"Upload-Offset": str(low)})
        assert answer.status_code == 200
    assert answer.json()["sha256"] == hashlib.sha256(data).hexdigest()
    assert answer.json()["state"] == "complete"
    left = list((api.service.blobs.folder or PLANT).glob(f"upload/{slot}/*"))
    assert left == []


@pytest.mark.parametrize("offset", ["0", "5", "50"])
def test_bytes_at_the_wrong_place(api: Api, offset: str) -> None:
    slot = api.client.post("/v1/uploads", json={"size": 100}).json()["id"]
    api.client.put(f"/v1/uploads/{slot}", content=b"x" * 10)
    answer = api.client.put(f"/v1/uploads/{slot}", content=b"x" * 10, headers={"Upload-Offset": offset})
    assert answer.status_code == 409
    assert answer.json()["offset"] == 10
    assert api.client.get(f"/v1/uploads/{slot}").json()["offset"] == 10, "nothing was appended"


def test_other_bytes_than_announced(api: Api) -> None:
    slot = api.client.post("/v1/uploads", json={"size": 4, "sha256": "0" * 64}).json()["id"]
    answer = api.client.put(f"/v1/uploads/{slot}", content=b"abcd")
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:mark3dgs:problem:digest-mismatch")
    assert api.client.get(f"/v1/uploads/{slot}").status_code == 404


@pytest.mark.parametrize("harm", [lambda path: path.write_bytes(path.read_bytes()[:-1]), Path.unlink, flip])
def test_a_stored_part_that_is_damaged_is_never_joined(api: Api, harm: Callable[[Path], object]) -> None:
    """It is held against its digest, also where none was announced."""
    data = SMALL.read_bytes()
    slot = api.client.post("/v1/uploads", json={"size": len(data)}).json()["id"]
    api.client.put(f"/v1/uploads/{slot}", content=data[:50_000])
    (part,) = (api.service.blobs.folder or PLANT).glob(f"upload/{slot}/*")
    harm(part)
    answer = api.client.put(f"/v1/uploads/{slot}", content=data[50_000:], headers={"Upload-Offset": "50000"})
    assert answer.status_code == 500
    assert "damaged at byte 0" in answer.json()["detail"]
    assert api.client.get(f"/v1/uploads/{slot}").status_code == 404, "it was dropped"


def chunks(total: int) -> Iterator[bytes]:
    for _ in range(total // 65536):
        yield bytes(65536)


@pytest.mark.parametrize("chunked", [False, True])
def test_over_the_limit(api: Api, chunked: bool) -> None:
    """Sized or chunked, the body ends where the limit is."""
    size = api.service.settings.max_upload_bytes + (1 << 20)
    slot = api.client.post("/v1/uploads", json={}).json()["id"]
    answer = api.client.put(f"/v1/uploads/{slot}", content=chunks(size) if chunked else bytes(size))
    assert answer.status_code == 413
    assert list(api.service.settings.scratch.glob("*")) == []


def test_more_than_announced(api: Api) -> None:
    slot = api.client.post("/v1/uploads", json={"size": 10}).json()["id"]
    assert api.client.put(f"/v1/uploads/{slot}", content=bytes(11)).status_code == 413


def test_a_slot_larger_than_the_limit(api: Api) -> None:
    assert api.client.post("/v1/uploads", json={"size": 1 << 40}).status_code == 413


def test_large_json_and_form(api: Api) -> None:
    body = b'{"label": "' + b"x" * 100_000 + b'"}'
    answer = api.client.post("/v1/keys", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 413
    form = api.client.post("/v1/verify", files={"model": ("m.ply", bytes(9 << 20))})
    assert form.status_code == 413


@pytest.mark.parametrize("head", [b"{", b"[", b" {", b"BM", b"\xff\xd8\xff", b"PK\3\4"])
def test_a_model_whose_first_number_reads_like_another_file(api: Api, head: bytes) -> None:
    """One marked .splat in a hundred begins with a brace, and was refused as cameras."""
    slot = api.upload(head + PLANT.read_bytes()[len(head) : 32 * 3000], "copy.splat")
    info = api.client.get(f"/v1/uploads/{slot}").json()["info"]
    assert (info["kind"], info["format"], info["gaussians"]) == ("model", "splat", 3000)


NOTHING = bytes(range(128, 205))
"""That no kind of file begins with."""


@pytest.mark.parametrize(
    ("name", "says"), [("room.psht", "Postshot"), ("a\\b\x07/scan.OBJ", "mesh"), ("x.ply", "none of")]
)
def test_the_ending_of_an_uploads_name_is_known_to_its_reader(api: Api, name: str, says: str) -> None:
    """Of bytes that tell nothing, the name is all that there is."""
    slot = api.client.post("/v1/uploads", json={"name": name}).json()["id"]
    answer = api.client.put(f"/v1/uploads/{slot}", content=NOTHING).json()
    assert answer["type"].endswith("unreadable-model")
    assert says in answer["detail"]


def test_the_reader_in_a_job_knows_the_name(api: Api, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What is too large to be looked at on arrival is read by its job for the first time."""
    monkeypatch.setattr(ingest, "INSPECTED_BYTES", 0)
    files = {"model": ("room.psht", NOTHING)}
    job = api.client.post("/v1/embed", data={"key_id": api.key()}, files=files).json()["id"]
    (row,) = api.service.db.query(sa.select(jobs).where(jobs.c.id == job)).all()
    run = SimpleNamespace(folder=tmp_path)
    task = api.service.local_model(json.loads(row.request), run)  # type: ignore[arg-type]
    with pytest.raises(UnsupportedFormatError, match="Postshot"):
        load_model(task)


def test_a_gltf_is_a_model_though_it_is_json(api: Api) -> None:
    slot = api.upload(gltf_of(*asset_of(splats(5, 0))), "scene.gltf")
    info = api.client.get(f"/v1/uploads/{slot}").json()["info"]
    assert (info["kind"], info["format"], info["gaussians"]) == ("model", "glb", 5)


def test_an_upload_of_cameras_and_of_a_picture(api: Api) -> None:
    file = io.BytesIO()
    Image.new("RGB", (40, 30)).save(file, "PNG")
    png = file.getvalue()
    slot = api.upload(png, "a.png")
    assert api.client.get(f"/v1/uploads/{slot}").json()["info"]["kind"] == "picture"
    embed = {"upload_id": slot, "key_id": api.key()}
    answer = api.client.post("/v1/embed", json=embed).json()
    assert answer["type"].endswith("unreadable-model")
    assert "takes pictures as 'images'" in answer["detail"]
    slot = api.client.post("/v1/uploads", json={}).json()["id"]
    assert api.client.put(f"/v1/uploads/{slot}", content=b"[{}]").json()["type"].endswith("unreadable-cameras")
    slot = api.client.post("/v1/uploads", json={}).json()["id"]
    lcc = api.client.put(f"/v1/uploads/{slot}", content=b'{"version": "5.0", "totalSplats": 9}').json()
    assert lcc["type"].endswith("unreadable-model")
    assert "XGRIDS" in lcc["detail"]
