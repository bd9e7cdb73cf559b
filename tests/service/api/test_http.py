"""HTTP as the standards have it: methods and their answers, conditions on downloads, lists, bodies."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from service import processes
from tests.service.api.conftest import SMALL, Api, _api
from tests.service.rows import add_asset


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("PATCH", "/v1/assets", "GET, HEAD"),
        ("PUT", "/v1/keys", "GET, HEAD, POST"),
        ("POST", "/v1/uploads/x", "DELETE, GET, HEAD, PUT"),
        ("POST", "/v1/assets/x/model", "GET, HEAD"),
        ("PUT", "/v1/claims/x", "DELETE, GET, HEAD"),
        ("PUT", "/v1/claims/x.jws", "GET, HEAD"),
        ("GET", "/v1/embed", "POST"),
        ("POST", "/", "GET, HEAD"),
    ],
)
def test_405_says_what_is_allowed(api: Api, method: str, path: str, allowed: str) -> None:
    answer = api.client.request(method, path)
    assert (answer.status_code, answer.headers["allow"]) == (405, allowed)


@pytest.mark.parametrize("path", ["/v1/embed", "/v1/verify", "/v1/keys", "/v1/uploads", "/v1/disputes"])
@pytest.mark.parametrize("body", [b"[" * 60_000, b'{"a":' * 12_000, b"\xff\xfe", b'{"label": ' + b"9" * 5000 + b"}"])
def test_json_that_is_none(api: Api, path: str, body: bytes) -> None:
    answer = api.client.post(path, content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 400, answer.text


def test_an_offending_value_is_named_but_no_key(api: Api) -> None:
    problem = api.client.post("/v1/embed", json={"upload_id": "up_1", "psnr": 12, "profile": "x" * 900}).json()
    places = {each["place"]: each["text"] for each in problem["errors"]}
    assert places["body.psnr"].endswith(", not '12'")
    assert places["body.profile"].endswith(f", not {'x' * 40!r}")
    assert "12" in problem["detail"]
    secret = "5" * 63
    assert secret[:9] not in api.client.post("/v1/keys", json={"key": secret, "label": 7}).text


@pytest.mark.parametrize("what", ["keys", "jobs", "assets", "claims", "uploads"])
def test_a_page_after_nothing(api: Api, stranger: Api, what: str) -> None:
    """Unknown and another tenant's are refused in the same words."""
    theirs = stranger.upload(SMALL.read_bytes())
    said = []
    for after in ("nothing", theirs):
        answer = api.client.get(f"/v1/{what}", params={"after": after})
        assert (answer.status_code, answer.json()["type"]) == (422, "urn:mark3dgs:problem:invalid-request")
        said.append(answer.json()["detail"].replace(after, ""))
    assert said[0] == said[1]


@pytest.fixture
def model(service: Any, request: pytest.FixtureRequest) -> tuple[Api, str, bytes]:
    """Address and bytes of an asset's model."""
    tenant = "tenant of downloads"
    api = _api(service, tenant, ["admin"])
    data = SMALL.read_bytes()
    digest = api.client.get(f"/v1/uploads/{api.upload(data)}").json()["sha256"]
    name = f"as_{request.node.name}"
    add_asset(service.db, id=name, tenant=tenant, job=name, model_sha256=digest, model_format="ply")
    return api, f"/v1/assets/{name}/model", data


def test_head(model: tuple[Api, str, bytes]) -> None:
    api, path, data = model
    answer = api.client.head(path)
    assert (answer.status_code, answer.content) == (200, b"")
    assert answer.headers["content-length"] == str(len(data))
    assert answer.headers["etag"] == api.client.get(path).headers["etag"]
    part = api.client.head(path, headers={"Range": "bytes=10-19"})
    assert (part.status_code, part.headers["content-length"]) == (206, "10")
    assert api.client.head("/v1/assets/nothing/model").status_code == 404
    listed = api.client.head("/v1/assets")
    assert (listed.status_code, listed.content) == (200, b"")


def test_conditions(model: tuple[Api, str, bytes]) -> None:
    api, path, data = model
    etag = api.client.get(path).headers["etag"]
    for known in (etag, f"W/{etag}", f'"other", {etag}', "*"):
        answer = api.client.get(path, headers={"If-None-Match": known})
        assert (answer.status_code, answer.content, answer.headers["etag"]) == (304, b"", etag)
    assert api.client.get(path, headers={"If-None-Match": '"other"'}).content == data
    part = {"Range": "bytes=10-19"}
    for condition, status, content in (
        (etag, 206, data[10:20]),
        ('"other"', 200, data),
        (f"W/{etag}", 200, data),
        ("Wed, 21 Oct 2015 07:28:00 GMT", 200, data),
    ):
        answer = api.client.get(path, headers=part | {"If-Range": condition})
        assert (answer.status_code, answer.content) == (status, content)


def test_garbage_is_judged_the_same_under_load(api: Api) -> None:
    """Sixteen at once, each in its turn: none is taken without inspection."""

    def send(_: int) -> int:
        slot = api.client.post("/v1/uploads", json={}).json()["id"]
        return api.client.put(f"/v1/uploads/{slot}", content=b"a text of thirty-three bytes here").status_code

    limits = api.service.settings
    limits.inspect_seconds, before = 12.0, limits.inspect_seconds
    try:
        with ThreadPoolExecutor(16) as pool:
            assert set(pool.map(send, range(16))) == {422}
    finally:
        limits.inspect_seconds = before


def test_waiting_for_a_turn_does_not_count(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time for a look begins with the look."""
    monkeypatch.setattr(processes, "_turns", processes.Turns(1))
    seen: list[float] = []

    class Looks(processes._Single):
        def run(self, task: str, request: Any, folder: Any, go_on: Any = None) -> dict[str, Any]:
            time.sleep(0.5)
            seen.append(go_on("", 0.0))
            return {}

    monkeypatch.setattr(processes, "_Single", Looks)
    threads = [
        threading.Thread(target=processes.run_once, args=(api.service.settings, "inspect", {}, None, 1.4, tenant))
        for tenant in "abcd"
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen == [True] * 4
