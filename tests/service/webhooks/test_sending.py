"""Where a message may go: to no address of the operator's network, under whatever name; never elsewhere than there
where it was looked; never for long."""

from __future__ import annotations

import asyncio
import datetime
import socket
import ssl
import time
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

from service.open_network import NOWHERE, is_public
from service.webhooks import delivery
from service.webhooks.delivery import DELIVERED
from tests.service.webhooks.conftest import Receivers
from tests.service.webhooks.receiver import answer

PRIVATE = [
    "127.0.0.1",
    "127.255.255.254",
    "0.0.0.0",
    "10.0.0.1",
    "172.16.0.1",
    "192.168.1.1",
    "169.254.169.254",  # clouds tell their secrets there
    "100.64.0.1",
    "192.0.0.1",
    "198.18.0.1",
    "224.0.0.1",
    "240.0.0.1",
    "255.255.255.255",
    "::",
    "::1",
    "fe80::1",
    "fe80::1%2",
    "fc00::1",
    "fd12:3456::1",
    "fec0::1",
    "ff02::1",
    "::ffff:127.0.0.1",
    "::ffff:10.0.0.1",
    "::ffff:93.184.215.14",
    "::127.0.0.1",
    "64:ff9b::7f00:1",
    "64:ff9b::a00:1",
    "2002:7f00:1::",
    "2002:a00:1::",
    "2001:0:7f00:1::",
    "2001:db8::1",
]
PUBLIC = ["93.184.215.14", "8.8.8.8", "2606:4700:4700::1111", "2a00:1450:4001:80e::200e"]
Found = dict[str, list[str]]


def post(url: str, *, private: bool = True) -> tuple[int | None, str]:
    return asyncio.run(delivery.send(url, b"{}", {"X-Test": "1"}, private=private))


@pytest.fixture
def names(monkeypatch: pytest.MonkeyPatch) -> Found:
    """Names and their addresses; `asked` of them how often."""
    known: Found = {"asked": []}

    async def getaddrinfo(self: Any, host: str, port: int, **_: Any) -> list[Any]:
        known["asked"].append(host)
        if host not in known:
            raise socket.gaierror("unknown")
        return [(socket.AF_INET6 if ":" in each else socket.AF_INET, 1, 6, "", (each, port)) for each in known[host]]

    monkeypatch.setattr(asyncio.BaseEventLoop, "getaddrinfo", getaddrinfo)
    return known


@pytest.fixture
def connected(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Addresses that were connected to; none of them answers."""
    tried: list[str] = []

    async def connect(self: Any, sock: Any, address: Any) -> None:
        tried.append(address[0])
        raise ConnectionRefusedError

    async def create_connection(self: Any, factory: Any, host: str, *_: Any, **__: Any) -> None:
        tried.append(host)
        raise ConnectionRefusedError

    monkeypatch.setattr(asyncio.BaseEventLoop, "create_connection", create_connection)
    monkeypatch.setattr(asyncio.selector_events.BaseSelectorEventLoop, "sock_connect", connect)
    return tried


@pytest.mark.parametrize("address", PRIVATE)
def test_an_address_that_is_not_public(address: str, names: Found, connected: list[str]) -> None:
    assert not is_public(address)
    names["hooks.test"] = [address]
    assert post("https://hooks.test/", private=False) == (None, NOWHERE)
    assert connected == []


@pytest.mark.parametrize("address", PUBLIC)
def test_an_address_that_is(address: str, names: Found, connected: list[str]) -> None:
    assert is_public(address)
    names["hooks.test"] = [address]
    assert post("https://hooks.test/", private=False)[1].startswith("no answer")
    assert connected == [address]
    assert names["asked"] == ["hooks.test"], "looked up once: what it says a moment later does not count"


def test_one_bad_address_among_good_ones(names: Found, connected: list[str]) -> None:
    for addresses in (["8.8.8.8", "10.0.0.1"], ["::1", "8.8.8.8"], []):
        names["hooks.test"] = addresses
        assert post("https://hooks.test/", private=False) == (None, NOWHERE)
    assert post("https://unknown.test/", private=False) == (None, NOWHERE), "said alike of names that are not there"
    assert connected == []


def test_plain_http_only_where_private_is_allowed(names: Found, connected: list[str]) -> None:
    names["hooks.test"] = ["8.8.8.8"]
    assert post("http://hooks.test/", private=False) == (None, NOWHERE)
    assert connected == []


def test_spellings_of_this_machine_are_resolved_before_they_are_judged() -> None:
    """By the system's own resolver, which knows more of them than we do."""
    for host in ("2130706433", "0x7f000001", "127.1", "localhost", "[::1]", "[::ffff:7f00:1]"):
        assert post(f"https://{host}:1/", private=False) == (None, NOWHERE), host
    assert post("https://0177.0.0.1:1/", private=False) == (None, "no answer: InvalidURL")


def test_what_arrives(receivers: Receivers, names: Found) -> None:
    receiver = receivers()
    names["hooks.test"] = ["127.0.0.1"]
    assert post(f"http://hooks.test:{receiver.port}/a?b=c#d") == (204, DELIVERED)
    ((path, headers, body),) = receiver.got
    assert (path, body, headers["x-test"]) == ("/a?b=c", b"{}", "1")
    assert headers["host"] == f"hooks.test:{receiver.port}"


@pytest.mark.parametrize("status", [301, 302, 307, 308, 400, 404, 429, 500])
def test_no_redirects_and_no_other_status(receivers: Receivers, status: int) -> None:
    other = receivers()
    receiver = receivers(answer(status, Location=f"http://127.0.0.1:{other.port}/"))
    assert post(f"http://127.0.0.1:{receiver.port}/") == (status, f"answered {status}")
    assert (len(receiver.got), len(other.got)) == (1, 0)


def test_no_proxy(receivers: Receivers, monkeypatch: pytest.MonkeyPatch) -> None:
    """A proxy would look the name up again, where our look does not count."""
    proxy, receiver = receivers(), receivers()
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY", "all_proxy", "HTTPS_PROXY", "https_proxy"):
        monkeypatch.setenv(name, f"http://127.0.0.1:{proxy.port}")
    monkeypatch.setenv("NO_PROXY", "")
    monkeypatch.setenv("no_proxy", "")
    assert post(f"http://127.0.0.1:{receiver.port}/")[0] == 204
    assert (len(receiver.got), len(proxy.got)) == (1, 0)


def drip_headers(handler: BaseHTTPRequestHandler) -> None:
    """A byte at a time, each before a timeout of reading would end."""
    try:
        for letter in b"HTTP/1.1 200 OK\r\nX: " + b"y" * 60:
            handler.wfile.write(bytes([letter]))
            time.sleep(0.1)
    except OSError:
        pass


def pour(handler: BaseHTTPRequestHandler) -> None:
    """A body without an end."""
    handler.send_response(200)
    handler.end_headers()
    try:
        while True:
            handler.wfile.write(bytes(1 << 16))
    except OSError:
        pass


def test_nobody_holds_us_for_long(receivers: Receivers, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delivery, "SECONDS", 1.0)
    began = time.monotonic()
    assert post(f"http://127.0.0.1:{receivers(drip_headers).port}/") == (None, "no answer within 1 s")
    assert time.monotonic() - began < 4
    assert post(f"http://127.0.0.1:{receivers(pour).port}/") == (200, DELIVERED), "of a body nothing is read"


def test_who_does_not_answer() -> None:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        assert post(f"http://127.0.0.1:{closed.getsockname()[1]}/") == (None, "no answer: ConnectError")


def certificate(folder: Path, name: str) -> ssl.SSLContext:
    """A server's side of a certificate for a name, signed by itself; it is in the file `cert.pem`."""
    key = ec.generate_private_key(ec.SECP256R1())
    who = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    today = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder(who, who, key.public_key(), x509.random_serial_number())
        .not_valid_before(today - datetime.timedelta(days=1))
        .not_valid_after(today + datetime.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
        .sign(key, SHA256())
    )
    (folder / "cert.pem").write_bytes(made.public_bytes(Encoding.PEM))
    (folder / "key.pem").write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / "cert.pem", folder / "key.pem")
    return context


def test_the_certificate_is_that_of_the_name(
    tmp_path: Path, receivers: Receivers, names: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though the connection goes to an address: who sits there under another name learns nothing."""
    receiver = receivers(answer(204), certificate(tmp_path, "hooks.test"))
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "cert.pem"))
    names |= {"hooks.test": ["127.0.0.1"], "other.test": ["127.0.0.1"]}
    assert post(f"https://hooks.test:{receiver.port}/") == (204, DELIVERED)
    assert post(f"https://other.test:{receiver.port}/") == (None, "no answer: ConnectError")
    monkeypatch.delenv("SSL_CERT_FILE")
    assert post(f"https://hooks.test:{receiver.port}/") == (None, "no answer: ConnectError"), "an unknown authority"
    assert len(receiver.got) == 1
