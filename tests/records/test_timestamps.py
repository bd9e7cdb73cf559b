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
from cryptography.hazmat.primitives.asymmetric import ec, utils

from engine.records import timestamps
from engine.records.timestamps import (
    TimestampFault,
    check_stamp,
    drawn_from,
    make_query,
    qualification,
    stamp,
    stamped_at,
)

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

QUALIFIED = """
[ qc ]
first = SEQUENCE:qc_type
second = SEQUENCE:qc_compliance
[ qc_type ]
id = OID:0.4.0.1862.1.4
[ qc_compliance ]
id = OID:0.4.0.1862.1.1
[ tsa ]
1.3.6.1.5.5.7.1.3 = ASN1:SEQUENCE:qc
"""


class Authority:
    """A certificate authority and a time-stamping service under it, in a folder."""

    def __init__(self, folder: Path, *, rsa: bool = False, qualified: bool = False) -> None:
        self.folder = folder
        (folder / "config").write_text(CONFIG.replace("[ tsa ]", QUALIFIED) if qualified else CONFIG)
        (folder / "serial").write_text("01")
        kind = ["rsa:2048"] if rsa else ["ec", "-pkeyopt", "ec_paramgen_curve:P-256"]
        new_key = ["-newkey", *kind, "-nodes", "-config", "config"]
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
    """Some bits in a reply are not signed (its wrapping); none of them changes what it says."""
    at, drawn, refused = stamped_at(token, JWS), drawn_from(token), 0
    for spot in range(0, len(token), 3):
        bent = token[:spot] + bytes([token[spot] ^ 1 << spot % 8]) + token[spot + 1 :]
        try:
            assert check_stamp(bent, JWS, authority.roots) == at
            assert drawn_from(bent) == drawn
        except TimestampFault:
            refused += 1
    assert refused > 0.95 * len(token) / 3


def parts(data: bytes) -> list[tuple[int, bytes]]:
    """Tag and content of each DER value in turn."""
    found = []
    while data:
        width = data[1] & 0x7F if data[1] & 0x80 else 0
        length = int.from_bytes(data[2 : 2 + width], "big") if width else data[1]
        found.append((data[0], data[2 + width : 2 + width + length]))
        data = data[2 + width + length :]
    return found


def der(tag: int, content: bytes) -> bytes:
    """One DER value."""
    size = len(content)
    width = (size.bit_length() + 7) // 8
    return bytes([tag, size] if size < 128 else [tag, 0x80 | width, *size.to_bytes(width, "big")]) + content


def with_signer(token: bytes, change: Callable[[list[tuple[int, bytes]]], list[tuple[int, bytes]]]) -> bytes:
    """The stamp with other parts of its one SignerInfo, all lengths made to fit."""

    def last(data: bytes, depth: int) -> bytes:
        *before, (tag, content) = parts(data)
        inner = b"".join(der(*each) for each in change(parts(content))) if depth == 0 else last(content, depth - 1)
        return b"".join(der(*each) for each in before) + der(tag, inner)

    return last(token, 5)  # reply, ContentInfo, [0], SignedData, SignerInfos, SignerInfo


def test_the_other_signature_that_anybody_can_make_draws_the_same(authority: Authority, token: bytes) -> None:
    """(r, n - s) holds where (r, s) does, and is another text, too: by itself it would be a second draw for nothing."""
    order = ec.SECP256R1().group_order

    def mirrored(signer: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
        r, s = utils.decode_dss_signature(signer[-1][1])
        return [*signer[:-1], (0x04, utils.encode_dss_signature(r, order - s))]

    other = with_signer(token, mirrored)
    assert with_signer(token, lambda signer: signer) == token
    assert with_signer(other, mirrored) == token != other
    assert check_stamp(other, JWS, authority.roots) == stamped_at(token, JWS)
    assert drawn_from(other) == drawn_from(token)


def test_what_nobody_signed_draws_nothing(authority: Authority, token: bytes) -> None:
    """The holder of a stamp can add unsigned attributes, and certificates in any number."""
    attribute = der(0x30, bytes.fromhex("06032a0304") + der(0x31, der(0x04, b"mine")))
    more = with_signer(token, lambda signer: [*signer, (0xA1, attribute)])
    assert more != token
    assert check_stamp(more, JWS, authority.roots) == stamped_at(token, JWS)
    assert drawn_from(more) == drawn_from(token)


def test_two_signers_draw_nothing(token: bytes) -> None:
    """Whoever may add one of his own chooses."""
    (_, reply), (*_, end) = parts(token)[0], parts(token)[1:] or (None,)
    assert end is None
    status, (tag, info) = parts(reply)
    kind, (_, wrapped) = parts(info)
    (_, signed), *_ = parts(wrapped)
    *before, (_, signers) = parts(signed)
    both = b"".join(der(*each) for each in before) + der(0x31, signers + signers)
    twice = der(0x30, der(*status) + der(tag, der(*kind) + der(0xA0, der(0x30, both))))
    with pytest.raises(TimestampFault):
        drawn_from(twice)


@pytest.mark.parametrize("rsa", [False, True])
def test_each_request_draws_anew(tmp_path: Path, rsa: bool) -> None:
    authority = Authority(tmp_path, rsa=rsa)
    tokens = [authority.reply(make_query(JWS)) for _ in range(3)]
    assert len({drawn_from(each) for each in tokens}) == 3
    for each in tokens:
        check_stamp(each, JWS, authority.roots)
        assert len(drawn_from(each)) == 64


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


def with_certificate(token: bytes, certificate: x509.Certificate) -> bytes:
    """The stamp with one more certificate among those that come along, which no signature covers."""
    from cryptography.hazmat.primitives.serialization import Encoding

    def grow(data: bytes, depth: int) -> bytes:
        values = parts(data)
        if depth == 0:
            at = next(index for index, (tag, _) in enumerate(values) if tag == 0xA0)
            there = [der(*each) for each in parts(values[at][1])]
            values[at] = (0xA0, b"".join(sorted([*there, certificate.public_bytes(Encoding.DER)])))
        else:
            values[-1] = (values[-1][0], grow(values[-1][1], depth - 1))
        return b"".join(der(*each) for each in values)

    return grow(token, 4)


def test_a_qualified_stamp_is_told_from_a_plain_one(authority: Authority, token: bytes, tmp_path: Path) -> None:
    other = Authority(tmp_path, qualified=True)
    qualified = other.reply(make_query(JWS))
    check_stamp(qualified, JWS, other.roots)
    own = x509.load_pem_x509_certificate((tmp_path / "tsa.pem").read_bytes())
    for listed in (other.roots, [own], [*authority.roots, own]):
        assert qualification(qualified, listed) == "a qualified time stamp (eIDAS)"
    assert qualification(qualified, []) == "", "there is nothing to tell it by"
    assert qualification(qualified, authority.roots).startswith("a plain"), "it is on no list"
    assert qualification(token, authority.roots).startswith("a plain"), "it states nothing of the kind"
    dressed = with_certificate(token, own)
    check_stamp(dressed, JWS, authority.roots)
    assert qualification(dressed, [*authority.roots, *other.roots]).startswith("a plain"), "another's certificate"
