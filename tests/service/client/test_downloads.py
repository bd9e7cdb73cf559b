"""Downloads of the client: whole or not at all, and continued where they broke."""

from __future__ import annotations

import hashlib
from pathlib import Path

import httpx
import pytest

from service.client import ServiceError, downloads, wire
from tests.service.client.driving import Breaking, Handler, do, problem

WHOLE = bytes(range(256)) * 40
ETAG = f'"{hashlib.sha256(WHOLE).hexdigest()}"'


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(downloads, "FIRST_PAUSE", 0.001)
    monkeypatch.setattr(wire, "_CHUNK", 1000)


def service(*, comes: int, etag: str = ETAG, calls: list[httpx.Request] | None = None) -> Handler:
    """Sends WHOLE, or the part that is requested; each connection breaks after `comes` bytes."""

    def answer(request: httpx.Request) -> httpx.Response:
        if calls is not None:
            calls.append(request)
        start = int(request.headers.get("range", "bytes=0-")[6:-1])
        rest = WHOLE[start:]
        headers = {"ETag": etag, "Content-Length": str(len(rest))}
        stream = httpx.ByteStream(rest) if len(rest) <= comes else Breaking(rest[:comes])
        return httpx.Response(206 if start else 200, headers=headers, stream=stream)

    return answer


def test_a_download_is_continued_where_it_broke(tmp_path: Path) -> None:
    target, calls, seen = tmp_path / "m.ply", list[httpx.Request](), list[float]()
    target.write_bytes(b"older")
    handler = service(comes=4000, calls=calls)
    got = do(handler, "download", "as_1", target, format="ply", progress=lambda _, share: seen.append(share))
    assert got == target
    assert target.read_bytes() == WHOLE
    assert [path.name for path in tmp_path.iterdir()] == ["m.ply"]
    assert [request.headers.get("range") for request in calls] == [None, "bytes=4000-", "bytes=8000-"]
    assert {request.headers.get("if-range") for request in calls[1:]} == {ETAG}
    assert {request.headers["accept-encoding"] for request in calls} == {"identity"}
    assert dict(calls[0].url.params) == {"version": "marked", "format": "ply"}
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_a_file_that_changed_meanwhile_is_begun_anew(tmp_path: Path) -> None:
    calls = []

    def changed(request: httpx.Request) -> httpx.Response:
        calls.append(request)
        if len(calls) == 1:
            return httpx.Response(200, headers={"ETag": '"old"'}, stream=Breaking(b"old" * 500))
        return httpx.Response(200, headers={"ETag": ETAG}, content=WHOLE)

    do(changed, "record", "as_1", tmp_path / "r")
    assert (tmp_path / "r").read_bytes() == WHOLE


def test_other_bytes_than_announced_are_not_kept(tmp_path: Path) -> None:
    (tmp_path / "m").write_bytes(b"older")
    with pytest.raises(ServiceError, match="digest-mismatch"):
        do(service(comes=1 << 20, etag=f'"{"0" * 64}"'), "download", "as_1", tmp_path / "m")
    assert (tmp_path / "m").read_bytes() == b"older"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_line_that_gives_nothing_is_given_up(tmp_path: Path) -> None:
    calls: list[httpx.Request] = []

    def dead(request: httpx.Request) -> httpx.Response:
        calls.append(request)
        return service(comes=1000 if len(calls) == 1 else 0)(request)

    with pytest.raises(ServiceError, match="unreachable"):
        do(dead, "download", "as_1", tmp_path / "m")
    assert len(calls) == downloads.BREAKS + 1
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_of_one_that_was_stopped(tmp_path: Path) -> None:
    def stop(stage: str, share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        do(service(comes=1 << 20), "download", "as_1", tmp_path / "m", progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_a_refusal_makes_no_file(tmp_path: Path) -> None:
    with pytest.raises(ServiceError, match="forbidden: the value 7"):
        do(lambda request: problem("forbidden", 403), "download", "as_1", tmp_path / "m", version="original")
    assert list(tmp_path.iterdir()) == []
