"""Time stamps from a small time-stamping service on loopback (openssl), and from bad ones."""

from __future__ import annotations

import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from cryptography import x509

from engine.records import timestamps
from engine.records.timestamps import TimestampFault, check_stamp, stamp, stamped_at

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the time stamps")
JWS = b"eyJh.bbbb.cccc"

CONFIG = """
[ req ]
distinguished_name = dn
prompt = no
[ dn ]
CN = Test authority
[ ca ]
basicConstraints = critical,CA:TRUE
keyUsage = critical,keyCertSign
subjectKeyIdentifier = hash
[ tsa ]
basicConstraints = critical,CA:FALSE
keyUsage = critical,digitalSignature
extendedKeyUsage = critical,timeStamping
subjectKeyIdentifier = hash
authorityKeyIdentifier = keyid
[ tsa_config ]
serial = ./serial
crypto_device = builtin
signer_cert = ./tsa.pem
signer_key = ./tsa.key
signer_digest = sha256
default_policy = 1.2.3.4.1
digests = sha256
ess_cert_id_alg = sha256
"""


class Authority:
    """A certificate authority and a time-stamping service under it, in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "config").write_text(CONFIG)
        (folder / "serial").write_text("01")
        new_key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-config", "config"]
        self.run("req", "-x509", "-days", "2", "-extensions", "ca", "-keyout", "ca.key", "-out", "ca.pem", *new_key)
        self.run("req", "-keyout", "tsa.key", "-out", "tsa.csr", "-subj", "/CN=Test stamps", *new_key)
        self.run(
            "x509",
            "-req",
            "-in",
            "tsa.csr",
            "-CA",
            "ca.pem",
            "-CAkey",
            "ca.key",
            "-CAcreateserial",
            "-days",
            "2",
            "-extfile",
            "config",
            "-extensions",
            "tsa",
            "-out",
            "tsa.pem",
        )

    @property
    def roots(self) -> list[x509.Certificate]:
        return [x509.load_pem_x509_certificate((self.folder / "ca.pem").read_bytes())]

    def reply(self, query: bytes) -> bytes:
        (self.folder / "query").write_bytes(query)
        self.run("ts", "-reply", "-config", "config", "-section", "tsa_config", "-queryfile", "query", "-out", "reply")
        return (self.folder / "reply").read_bytes()

    def run(self, *arguments: str) -> None:
        subprocess.run(["openssl", *arguments], cwd=self.folder, check=True, capture_output=True, timeout=60)


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    return Authority(tmp_path_factory.mktemp("authority"))


@contextmanager
def serving(answer: Callable[[bytes], bytes], status: int = 200) -> Iterator[str]:
    """A service on loopback that gives this answer to a query."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            query = self.rfile.read(int(self.headers["Content-Length"]))
            assert self.headers["Content-Type"] == "application/timestamp-query"
            body = answer(query)
            self.send_response(status)
            self.end_headers()
            with suppress(OSError):  # the client has left
                self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def token(authority: Authority) -> bytes:
    with serving(authority.reply) as url:
        stamped = stamp(url, JWS)
    assert stamped.token is not None, stamped.failure
    return stamped.token


def test_a_stamp_holds_under_its_authority(authority: Authority, token: bytes) -> None:
    at = check_stamp(token, JWS, authority.roots)
    assert at == stamped_at(token, JWS)
    assert at.startswith("20")
    assert at.endswith("+00:00")


def test_openssl_takes_the_stamp_too(authority: Authority, token: bytes) -> None:
    """A reader without this program can check it."""
    (authority.folder / "token").write_bytes(token)
    (authority.folder / "claim.jws").write_bytes(JWS)
    authority.run("ts", "-verify", "-in", "token", "-data", "claim.jws", "-CAfile", "ca.pem")


def test_a_stamp_of_something_else_is_refused(authority: Authority, token: bytes) -> None:
    for check in (lambda: stamped_at(token, JWS + b"x"), lambda: check_stamp(token, JWS + b"x", authority.roots)):
        with pytest.raises(TimestampFault, match="of something else"):
            check()


def test_a_stamp_of_another_authority_is_refused(token: bytes, tmp_path: Path) -> None:
    other = Authority(tmp_path)
    with pytest.raises(TimestampFault, match="does not hold"):
        check_stamp(token, JWS, other.roots)


def test_a_changed_stamp_is_refused_or_says_the_same(authority: Authority, token: bytes) -> None:
    """Some bits in a reply are signed by nobody (its wrapping); none of them changes what it says."""
    at, refused = stamped_at(token, JWS), 0
    for spot in range(0, len(token), 3):
        bent = token[:spot] + bytes([token[spot] ^ 1 << spot % 8]) + token[spot + 1 :]
        try:
            assert check_stamp(bent, JWS, authority.roots) == at
        except TimestampFault:
            refused += 1
    assert refused > 0.95 * len(token) / 3


@pytest.mark.parametrize(
    ("answer", "status", "said"),
    [
        (b"", 200, "no time stamp"),
        (b"<html>", 200, "this is no time stamp"),
        (b"x" * 70_000, 200, "longer than"),
        (b"busy", 503, "503"),
        (b"\x30\x03\x02\x01\x02", 200, "no time stamp"),
        (b"\x30\x05\x30\x03\x02\x01\x02", 200, "refused"),
    ],
)
def test_bad_answers_are_reported_and_never_fatal(answer: bytes, status: int, said: str) -> None:
    with serving(lambda _: answer, status) as url:
        stamped = stamp(url, JWS)
    assert stamped.token is None
    assert said in stamped.failure


def test_an_old_answer_is_not_taken_for_a_new_one(token: bytes) -> None:
    with serving(lambda _: token) as url:
        assert "answers another request" in stamp(url, JWS).failure


def test_a_silent_or_slow_service_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timestamps, "SECONDS", 0.3)
    gate = threading.Event()
    with serving(lambda _: bytes(gate.wait(5))) as url:
        stamped = stamp(url, JWS)
        gate.set()
    assert stamped.token is None
    assert "timed out" in stamped.failure


@pytest.mark.parametrize("url", ["file:///etc/hostname", "ftp://127.0.0.1/", "http://127.0.0.1:1/", "http://", "x"])
def test_addresses_that_do_not_answer(url: str) -> None:
    stamped = stamp(url, JWS)
    assert stamped.token is None
    assert stamped.failure.startswith("no time stamp: ")
