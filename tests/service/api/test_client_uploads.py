"""Uploads by the client, against the application: broken connections cost one piece at most."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from service.client import Client, ServiceError, calls
from service.uploads import ingest
from tests.service.api.conftest import SMALL, Api

DATA = SMALL.read_bytes()
PIECE = 50_000
Way = Callable[[httpx.BaseTransport, httpx.Request], httpx.Response]


@pytest.fixture(autouse=True)
def _small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    assert 3 * PIECE < len(DATA) < 5 * PIECE
    monkeypatch.setattr(calls, "PIECE", PIECE)
    monkeypatch.setattr(calls, "FIRST_PAUSE", 0.001)
    monkeypatch.setattr(ingest, "run_once", lambda *_: {"format": "ply", "gaussians": 1000})  # looked at elsewhere


class Line(httpx.BaseTransport):
    """The way to the application, on which some pieces (PUT, counted from 0) meet with something."""

    def __init__(self, api: Api, events: dict[int, Way] | None = None) -> None:
        self.inner, self.events = api.client._transport, events or {}
        self.methods: list[str] = []
        self.sent = 0

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        puts = self.methods.count("PUT")
        self.methods.append(request.method)
        self.sent += len(request.read()) if request.method == "PUT" else 0
        happens = self.events.get(puts) if request.method == "PUT" else None
        return happens(self.inner, request) if happens else self.inner.handle_request(request)

    def client(self, api: Api) -> Client:
        token = api.client.headers["authorization"].removeprefix("Bearer ")
        return Client("http://testserver", token, transport=self)


def lost(way: httpx.BaseTransport, request: httpx.Request) -> httpx.Response:
    """The request never arrives."""
    raise httpx.ConnectError("lost")


def halved(way: httpx.BaseTransport, request: httpx.Request) -> httpx.Response:
    """A part of it arrives."""
    half = request.content[: len(request.content) // 2]
    headers = {name: value for name, value in request.headers.items() if name != "content-length"}
    way.handle_request(httpx.Request("PUT", request.url, headers=headers, content=half)).read()
    raise httpx.WriteError("broken")


def unanswered(way: httpx.BaseTransport, request: httpx.Request) -> httpx.Response:
    """It arrives, and its answer does not."""
    way.handle_request(request).read()
    raise httpx.ReadError("broken")


@pytest.mark.parametrize("way", [lost, halved, unanswered])
@pytest.mark.parametrize("piece", [0, 1, 3])
def test_a_broken_connection_costs_a_piece(api: Api, way: Way, piece: int) -> None:
    """The first, one in the middle, or the last, after which the upload is complete."""
    line, seen = Line(api, {piece: way}), list[float]()
    done = line.client(api).upload(SMALL, progress=lambda stage, share: seen.append(share))
    assert (done.state, done.sha256, done.size) == ("complete", hashlib.sha256(DATA).hexdigest(), len(DATA))
    assert done.info is not None
    assert done.info["gaussians"] == 1000
    assert (seen, seen[-1]) == (sorted(seen), 1.0)
    assert line.sent <= len(DATA) + PIECE


def test_a_line_that_takes_nothing_is_given_up(api: Api) -> None:
    line = Line(api, dict.fromkeys(range(100), lost))
    with pytest.raises(ServiceError, match="unreachable: ConnectError"):
        line.client(api).upload(DATA)
    assert line.methods.count("PUT") == 4


def test_a_stopped_upload_is_continued_by_the_next_try(api: Api) -> None:
    """Of another process, too: the service knows the file by its digest."""

    def stop(stage: str, share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Line(api).client(api).upload(DATA, progress=stop)
    line = Line(api)
    done = line.client(api).upload(SMALL)
    assert done.state == "complete"
    assert line.methods.count("POST") == 0
    assert line.sent < 0.5 * len(DATA)


def test_another_file_has_its_own_upload(api: Api) -> None:
    """One of the same name and size, of which other bytes are on their way."""
    other = bytes([DATA[-1] ^ 1]) + DATA[1:]
    slot = api.client.post("/v1/uploads", json={"size": len(other), "sha256": hashlib.sha256(other).hexdigest()})
    line = Line(api)
    assert line.client(api).upload(DATA).id != slot.json()["id"]
    assert line.sent == len(DATA)


def test_a_file_that_became_shorter(api: Api, tmp_path: Path) -> None:
    path = tmp_path / "m.ply"
    path.write_bytes(DATA)

    def cut(stage: str, share: float) -> None:
        path.write_bytes(DATA[:PIECE])

    with pytest.raises(ServiceError, match=r"changed: 'm\.ply' became shorter"):
        Line(api).client(api).upload(path, progress=cut)


def test_what_the_service_refuses_is_said(api: Api) -> None:
    with pytest.raises(ServiceError) as caught:
        Line(api).client(api).upload(bytes(api.service.settings.max_upload_bytes + 1))
    assert (caught.value.code, caught.value.status) == ("too-large", 413)
    with pytest.raises(ServiceError, match="invalid-request"):
        Line(api).client(api).upload(b"")
