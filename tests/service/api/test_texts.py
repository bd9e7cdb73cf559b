"""Texts that no database holds: refused on every route, whatever the database."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.core import Service
from service.settings import Settings
from tests.service.api.conftest import SMALL, Api, _api

ROOT = Path(__file__).parents[3]
DOCUMENT = json.loads((ROOT / "openapi" / "openapi.json").read_text())
OPERATIONS = [(method, path) for path, methods in DOCUMENT["paths"].items() for method in methods]
BODIES = {
    "/v1/uploads": {"name": "?"},
    "/v1/acquisitions": {"upload_id": "?"},
    "/v1/keys": {"label": "?"},
    "/v1/api-keys": {"label": "?", "scopes": ["read"]},
    "/v1/embed": {"upload_id": "up_1", "copy_name": "?"},
    "/v1/verify": {"image_upload_ids": ["?"]},
    "/v1/disputes": {"asset_a": "?", "asset_b": "as_1"},
    "/v1/webhooks": {"url": "https://example.com/?", "events": ["?"]},
}
BAD = ["\0", "a\0b", "\ud800", "a\udfffb", "\udc00\ud800"]


@pytest.fixture(scope="module", params=["sqlite", "postgres"])
def of_any(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """An administrator and operator of a service on either database."""
    url = request.getfixturevalue("postgres").new_database("texts") if request.param == "postgres" else ""
    made = Service.open(Settings(data_dir=tmp_path_factory.mktemp("texts"), database_url=url))
    yield _api(made, "t", ["admin", "operator"])
    made.close()


@pytest.mark.parametrize(("method", "path"), [each for each in OPERATIONS if "{" in each[1]])
def test_in_an_address(of_any: Api, method: str, path: str) -> None:
    answer = of_any.client.request(method, re.sub(r"\{\w+\}", "a%00b", path), content=b"{}")
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:mark3dgs:problem:invalid-request")


@pytest.mark.parametrize(("method", "path"), [each for each in OPERATIONS if "{" not in each[1] and each[0] == "get"])
def test_in_a_query(of_any: Api, method: str, path: str) -> None:
    for name in ("q", "after", "asset", "value", "anything"):
        assert of_any.client.get(f"{path}?{name}=a%00b").status_code == 422


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("path", BODIES)
def test_in_json(of_any: Api, path: str, bad: str) -> None:
    text = json.dumps(BODIES[path]).replace("?", json.dumps(bad)[1:-1])
    answer = of_any.client.post(path, content=text, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422, answer.text


def test_every_body_is_among_them() -> None:
    """Of the operations that take text; a share's has a number alone, and content is a file's own bytes."""
    taking = {path for path, methods in DOCUMENT["paths"].items() if "requestBody" in methods.get("post", {})}
    assert taking - {"/v1/claims/{claim_id}/share", "/v1/matches/byContent"} == set(BODIES)


@pytest.mark.parametrize("where", ["field", "file"])
def test_in_a_form(of_any: Api, where: str) -> None:
    name = b"a\0b.ply" if where == "file" else b"a.ply"
    text = b"a\0b" if where == "field" else b"a"
    body = b'--x\r\nContent-Disposition: form-data; name="label"\r\n\r\n' + text
    body += b'\r\n--x\r\nContent-Disposition: form-data; name="model"; filename="' + name + b'"\r\n\r\n'
    body += SMALL.read_bytes() + b"\r\n--x--\r\n"
    headers: dict[str, Any] = {"Content-Type": "multipart/form-data; boundary=x"}
    assert of_any.client.post("/v1/embed", content=body, headers=headers).status_code == 422


def test_what_is_no_half_is_kept(of_any: Api) -> None:
    """A face, in JSON as a pair of surrogates."""
    body = b'{"label": "\\ud83d\\ude00"}'
    answer = of_any.client.post("/v1/keys", content=body, headers={"Content-Type": "application/json"})
    assert answer.json()["label"] == "\U0001f600"
