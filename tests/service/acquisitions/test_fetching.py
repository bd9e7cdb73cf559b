"""What is fetched, from where, and how it is kept."""

from __future__ import annotations

import asyncio
import base64
import gzip
import hashlib
import json
import ssl
import time
import zlib
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import pytest

from service.acquisitions import fetching
from service.acquisitions.archive import write_warc
from service.acquisitions.fetching import Exchange, fetch
from service.problems import Problem
from service.uploads.store import Received
from tests.service.acquisitions.conftest import Names, Site, answer
from tests.service.webhooks.test_sending import certificate

Sites = Callable[..., Site]
NOT_PUBLIC = (
    "127.0.0.1",
    "::1",
    "169.254.169.254",
    "::ffff:127.0.0.1",
    "::ffff:169.254.169.254",
    "10.0.0.1",
    "224.0.0.1",
)


def get(url: str, target: Path, *, most: int = 1 << 20, seconds: float = 5.0, private: bool = True) -> Any:
    return asyncio.run(fetch(url, target, most, seconds, private=private))


def refused(url: str, target: Path, **limits: Any) -> Problem:
    with pytest.raises(Problem) as caught:
        get(url, target, **limits)
    return caught.value


def warc_records(data: bytes) -> list[tuple[dict[str, str], bytes]]:
    """Headers and block of each record, read by the letter of ISO 28500: one gzip member each."""
    found = []
    while data:
        member = zlib.decompressobj(wbits=31)
        record = member.decompress(data)
        data = member.unused_data
        head, _, rest = record.partition(b"\r\n\r\n")
        version, *lines = head.decode().split("\r\n")
        assert version == "WARC/1.1"
        headers = dict(line.split(": ", 1) for line in lines)
        block = rest[: int(headers["Content-Length"])]
        assert rest == block + b"\r\n\r\n"
        found.append((headers, block))
    return found


def sha256_of(data: bytes) -> str:
    return "sha256:" + base64.b32encode(hashlib.sha256(data).digest()).decode()


@pytest.mark.parametrize("address", NOT_PUBLIC)
def test_no_address_of_our_own_network_is_asked(address: str, names: Names, tmp_path: Path) -> None:
    names["models.test"] = ["93.184.215.14", address]
    host = f"[{address}]" if ":" in address else address
    for name in ("models.test", host):
        problem = refused(f"http://{name}/x.ply", tmp_path / "x", private=False)
        assert (problem.kind, "not public" in problem.detail) == ("not-fetched", True)


@pytest.mark.parametrize(
    "goal", ["http://127.0.0.1:{port}/", "http://metadata.test:{port}/", "//[::ffff:127.0.0.1]:{port}/"]
)
def test_a_redirect_is_judged_like_the_first(
    goal: str, sites: Sites, names: Names, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret = sites(answer(b"secret"))
    lure = sites(answer(b"", 302, Location=goal.format(port=secret.port)))
    names |= {"lure.test": ["127.0.0.1"], "metadata.test": ["169.254.169.254"]}

    async def resolve(url: Any, *, private: bool) -> str | None:
        return "127.0.0.1" if url.host == "lure.test" else await known(url, private=private)

    known = fetching.resolve
    monkeypatch.setattr(fetching, "resolve", resolve)
    problem = refused(lure.url(name="lure.test"), tmp_path / "x", private=False)
    assert "not public" in problem.detail
    assert (lure.got, secret.got) == (["/"], [])


@pytest.mark.parametrize(
    "url", ["file:///etc/passwd", "gopher://127.0.0.1/", "http://user:secret@127.0.0.1/", "http:///x"]
)
def test_what_is_no_address_of_the_web(url: str, tmp_path: Path) -> None:
    assert refused(url, tmp_path / "x").kind == "not-fetched"
    assert not (tmp_path / "x").exists()


def test_a_redirect_to_a_file(sites: Sites, tmp_path: Path) -> None:
    assert refused(sites(answer(b"", 302, Location="file:///etc/passwd")).url(), tmp_path / "x").kind == "not-fetched"


def test_redirects_end(sites: Sites, tmp_path: Path) -> None:
    site = sites(answer(b"", 302, Location="/again"))
    assert "redirects" in refused(site.url(), tmp_path / "x").detail
    assert len(site.got) == fetching.MOST_REDIRECTS + 1


def endless(handler: BaseHTTPRequestHandler) -> None:
    handler.send_response(200)
    handler.end_headers()
    while True:
        handler.wfile.write(bytes(1 << 14))


def test_a_body_that_is_too_large(sites: Sites, tmp_path: Path) -> None:
    assert refused(sites(endless).url(), tmp_path / "x", most=1 << 16).kind == "too-large"
    assert refused(sites(answer(bytes(101))).url(), tmp_path / "x", most=100).kind == "too-large"


def test_a_slow_server(sites: Sites, tmp_path: Path) -> None:
    def drip(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.end_headers()
        for _ in range(100):
            handler.wfile.write(b"x")
            time.sleep(0.1)

    began = time.monotonic()
    assert "within 0.5 s" in refused(sites(drip).url(), tmp_path / "x", seconds=0.5).detail
    assert time.monotonic() - began < 3


@pytest.mark.parametrize(
    "behave",
    [answer(b"x", 404), answer(gzip.compress(b"x"), Content_Encoding="gzip"), answer(b"x", Content_Length="9")],
)
def test_what_is_no_whole_answer(behave: Any, sites: Sites, tmp_path: Path) -> None:
    def then_close(handler: BaseHTTPRequestHandler) -> None:
        behave(handler)
        handler.close_connection = True

    assert refused(sites(then_close).url(), tmp_path / "x").kind == "not-fetched"


def test_the_archive_has_all_of_it(sites: Sites, names: Names, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def chunked(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Transfer-Encoding", "chunked")
        handler.send_header("X-Odd", "\xe9")
        handler.end_headers()
        handler.wfile.write(b"4\r\nply \r\n3\r\nend\r\n0\r\n\r\n")

    site = sites(chunked, certificate(tmp_path, "models.test"))
    lure = sites(answer(b"", 301, Location=f"https://models.test:{site.port}/a.ply?b=1"))
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "cert.pem"))
    names["models.test"] = ["127.0.0.1"]
    exchanges, got = get(lure.url("/start"), tmp_path / "body")
    assert got == Received(7, hashlib.sha256(b"ply end").hexdigest(), whole=True)
    write_warc(tmp_path / "a.warc.gz", tmp_path / "body", exchanges, "", "")
    records = warc_records((tmp_path / "a.warc.gz").read_bytes())
    kinds = [headers["WARC-Type"] for headers, _ in records]
    assert kinds == ["warcinfo", *["response", "request", "metadata"] * 2]
    assert "WARC-Filename" not in records[0][0], "it is written under a name of the moment"
    for headers, block in records[1:]:
        payload = block.partition(b"\r\n\r\n")[2] if "http" in headers["Content-Type"] else block
        assert headers["WARC-Block-Digest"] == sha256_of(block)
        assert headers["WARC-Payload-Digest"] == sha256_of(payload)
    last, block = records[4]
    assert block.endswith(b"\r\n\r\nply end")
    assert b"\r\nX-Odd: \xe9\r\n" in block
    assert (last["WARC-Target-URI"], last["WARC-IP-Address"]) == (exchanges[1].url, "127.0.0.1")
    assert records[5][1].startswith(b"GET /a.ply?b=1 HTTP/1.1\r\n")
    assert b"\r\nHost: models.test:%d\r\n" % site.port in records[5][1]
    leaf = json.loads(records[6][1])["tls_certificates"][0]
    assert ssl.DER_cert_to_PEM_cert(base64.b64decode(leaf)) == (tmp_path / "cert.pem").read_text()
    assert {headers["WARC-Concurrent-To"] for headers, _ in records[5:]} == {last["WARC-Record-ID"]}
    assert len({headers["WARC-Record-ID"] for headers, _ in records}) == 7


def test_a_file_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "my scan.ply").write_bytes(b"ply")
    none: list[Exchange] = []
    write_warc(
        tmp_path / "a.warc.gz", tmp_path / "my scan.ply", none, "my scan.ply", "2026-11-27T10:00:00.000000+00:00"
    )
    (_, _), (headers, block) = warc_records((tmp_path / "a.warc.gz").read_bytes())
    assert (headers["WARC-Type"], headers["WARC-Target-URI"], block) == ("resource", "file:///my%20scan.ply", b"ply")
    assert headers["WARC-Date"] == "2026-11-27T10:00:00.000000Z"
    assert headers["WARC-Payload-Digest"] == sha256_of(b"ply")
