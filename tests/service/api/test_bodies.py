"""Bodies: of whom they are read, and how slowly they may come."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from starlette.types import Message

from service.http import middleware
from tests.service import serving
from tests.service.api.conftest import Api
from tests.service.measure_load import drip

MULTIPART = "multipart/form-data; boundary=x"
FORM = b'--x\r\nContent-Disposition: form-data; name="model"; filename="a"\r\n\r\n'
ROUTES = [
    ("POST", "/v1/uploads", "application/json"),
    ("POST", "/v1/keys", "application/json"),
    ("POST", "/v1/disputes", "application/json"),
    ("POST", "/v1/webhooks", "application/json"),
    ("POST", "/v1/verify", "application/json"),
    ("POST", "/v1/verify", MULTIPART),
    ("POST", "/v1/embed", MULTIPART),
    ("POST", "/v1/claims/x/share", "application/json"),
    ("PUT", "/v1/uploads/x", "application/octet-stream"),
]


def ask(
    api: Api, method: str, path: str, kind: str, body: Callable[[int], Awaitable[Message]], key: bool = True
) -> tuple[int, dict[str, str], Any, float]:
    """Send a request whose body's pieces, by number, `body` gives; status, headers, answer and seconds."""
    got: list[Message] = []
    count = -1

    async def receive() -> Message:
        nonlocal count
        count += 1
        return await body(count)

    async def send(message: Message) -> None:
        got.append(message)

    headers = {"host": "t", "content-type": kind, "transfer-encoding": "chunked"}
    headers |= {"authorization": api.client.headers["authorization"]} if key else {}
    scope: dict[str, Any] = {"type": "http", "method": method, "path": path, "query_string": b"", "root_path": ""}
    scope |= {"scheme": "http", "http_version": "1.1", "raw_path": path.encode()}
    scope["headers"] = [(name.encode(), value.encode()) for name, value in headers.items()]
    began = time.monotonic()
    asyncio.run(api.client.app(scope, receive, send))
    said = b"".join(message.get("body", b"") for message in got)
    found = {name.decode(): value.decode() for name, value in got[0]["headers"]}
    return got[0]["status"], found, json.loads(said), time.monotonic() - began


async def nothing(_: int) -> Message:
    await asyncio.sleep(60)
    return {"type": "http.disconnect"}


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(middleware, "GRACE_SECONDS", 0.5)
    monkeypatch.setattr(middleware, "LINGER_SECONDS", 0.1)


@pytest.mark.parametrize(("method", "path", "kind"), ROUTES)
def test_without_a_key_no_body_is_waited_for(
    api: Api, method: str, path: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(middleware, "GRACE_SECONDS", 50.0)
    status, headers, said, seconds = ask(api, method, path, kind, nothing, key=False)
    assert (status, said["type"]) == (401, "urn:mark3dgs:problem:unauthorized")
    assert headers["connection"] == "close"
    assert seconds < 5


@pytest.mark.parametrize(("method", "path", "kind"), ROUTES[:-1])
def test_a_body_that_drips_is_given_up(api: Api, method: str, path: str, kind: str) -> None:
    async def drip(number: int) -> Message:
        await asyncio.sleep(0.05)
        return {"type": "http.request", "body": FORM[number : number + 1] or b"x", "more_body": True}

    status, headers, said, seconds = ask(api, method, path, kind, drip)
    assert (status, said["type"]) == (408, "urn:mark3dgs:problem:too-slow")
    assert headers["connection"] == "close"
    assert 0.5 <= seconds < 5


def test_a_slow_line_is_taken(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that sends what is needed, for longer than the grace."""
    monkeypatch.setattr(middleware, "SLOWEST", 100)
    slot = api.client.post("/v1/uploads", json={"size": 100}).json()["id"]

    async def trickle(number: int) -> Message:
        await asyncio.sleep(0.1)
        return {"type": "http.request", "body": b"x" * 10, "more_body": number < 8}

    status, _, said, seconds = ask(api, "PUT", f"/v1/uploads/{slot}", "application/octet-stream", trickle)
    assert (status, said["offset"]) == (200, 90)
    assert seconds > 0.8


@pytest.mark.parametrize(("method", "path", "kind"), ROUTES[:-1])
def test_a_client_that_leaves_is_no_fault(
    api: Api, method: str, path: str, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def leave(number: int) -> Message:
        body: Message = {"type": "http.request", "body": FORM, "more_body": True}
        return body if number == 0 else {"type": "http.disconnect"}

    with caplog.at_level(logging.WARNING):
        status = ask(api, method, path, kind, leave)[0]
    assert status < 500
    assert caplog.records == []


def test_many_who_drip_without_a_key(tmp_path: Path) -> None:
    """Each gets its answer and is gone; others are served meanwhile, and the log stays short."""
    served = serving.start(tmp_path, workers=0)
    try:
        found = drip(served, 200)
    finally:
        served.stop()
    assert found["statuses"] == {401: 200}
    assert found["health_most_s"] < 5
    assert found["all_ended_s"] < 20
    assert found["log_bytes"] < 2000


def test_what_still_comes_is_read_before_the_line_is_closed(api: Api) -> None:
    """Closed with bytes unread, a connection is reset, and its client may never see why."""
    read = []

    async def pieces(number: int) -> Message:
        read.append(number)
        return {"type": "http.request", "body": b"x" * 10, "more_body": number < 3}

    status, headers, _, _ = ask(api, "PUT", "/v1/uploads/x", "application/octet-stream", pieces, key=False)
    assert (status, headers["connection"]) == (401, "close")
    assert read == [0, 1, 2, 3]


def test_a_file_of_unknown_length_that_breaks_off_is_no_file(api: Api) -> None:
    slot = api.client.post("/v1/uploads", json={}).json()["id"]

    async def leave(number: int) -> Message:
        body: Message = {"type": "http.request", "body": b"x" * 10, "more_body": True}
        return body if number == 0 else {"type": "http.disconnect"}

    said = ask(api, "PUT", f"/v1/uploads/{slot}", "application/octet-stream", leave)[2]
    assert (said.get("state"), said.get("offset")) == ("open", 0)


def test_more_connections_than_wanted_are_refused(tmp_path: Path) -> None:
    served = serving.start(tmp_path, workers=0, CONNECTIONS="10")
    host, port = served.address.removeprefix("http://").split(":")
    try:
        lines = [socket.create_connection((host, int(port)), timeout=20) for _ in range(12)]
        lines[-1].sendall(b"GET /healthz HTTP/1.1\r\nHost: t\r\n\r\n")
        assert lines[-1].recv(100).startswith(b"HTTP/1.1 503 ")
        for line in lines:
            line.close()
        serving.wait_until_up(served.process, served.address, tmp_path / "log.txt")
    finally:
        served.stop()
