"""Attestations: bound to one record, believed only of those whom the reader trusts, read with care."""

from __future__ import annotations

import json
import re
import shutil
import struct
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
import rfc8785
from joserfc import jws
from joserfc.jwk import OKPKey

from engine.errors import MalformedRecordError
from engine.records.attestation import LOG, MOST, Attestation, Trust, attach, header_digest, read_attestations, stamp_of
from engine.records.file import APPENDED, public_bytes
from engine.records.merkle import leaf_hash, node_hash
from engine.records.record import Record, read_header
from engine.records.signatures import REGISTRATION
from engine.records.witnessing import check_attestations
from tests.data.records.make_golden import KEY, PATHS, golden_record
from tests.records.test_timestamps import Authority

GOLDEN = PATHS[1].read_bytes()
OTHER = golden_record().__class__.make(
    KEY, golden_record().reference_arrays, original_digest="cd" * 32, plan=({"message": "deadbeef"}, {})
)
SIGNER = OKPKey.generate_key("Ed25519", private=True)
JWKS = {"keys": [{**SIGNER.as_dict(private=False), "kid": SIGNER.thumbprint(), "alg": "Ed25519", "use": "sig"}]}


def statement(data: bytes = GOLDEN, kind: str = REGISTRATION, **changes: Any) -> Attestation:
    """A service's word: the second entry of a log of two."""
    payload = {"record_sha256": sha256(data).hexdigest(), "drawn_sha256": "ab" * 32}
    entry = {"index": 1, "at": "2026-02-03T04:05:06+00:00", "event": "asset.registered", "payload": payload}
    before, leaf = leaf_hash(b"first"), leaf_hash(rfc8785.dumps(entry))
    said = {
        "header_sha256": header_digest(data),
        "entry": entry,
        "size": 2,
        "proof": [before.hex()],
        "root": node_hash(before, leaf).hex(),
        **changes,
    }
    header = {"alg": "Ed25519", "kid": SIGNER.thumbprint(), "typ": kind}
    return Attestation(LOG, jws.serialize_compact(header, rfc8785.dumps(said), SIGNER, ["Ed25519"]))


def test_a_record_opens_with_what_was_added_and_says_the_same() -> None:
    whole = attach(GOLDEN, statement())
    assert whole.startswith(GOLDEN)
    assert Record.from_bytes(whole, KEY).to_bytes(KEY) == Record.from_bytes(GOLDEN, KEY).to_bytes(KEY)
    assert read_header(whole) == read_header(GOLDEN)
    assert public_bytes(whole) == public_bytes(GOLDEN)
    assert read_attestations(GOLDEN) == ()
    assert read_attestations(whole) == (statement(),)
    assert attach(whole, statement()) == whole
    assert len(read_attestations(attach(whole, Attestation(LOG, "a.b.c")))) == 2


def test_a_log_counts_for_whoever_trusts_its_service() -> None:
    (witness,), notes = check_attestations(attach(GOLDEN, statement()), Trust(jwks=JWKS))
    assert (witness.at, notes) == ("2026-02-03T04:05:06+00:00", ())
    assert SIGNER.thumbprint() in witness.by
    none, (note,) = check_attestations(attach(GOLDEN, statement()), Trust())
    assert none == ()
    assert "no public key was given" in note


@pytest.mark.parametrize(
    ("said", "text"),
    [
        (statement(OTHER.to_bytes(KEY)), "another record"),
        (statement(header_sha256="00" * 32), "another record"),
        (statement(root="00" * 32), "proof"),
        (statement(proof=[]), "proof"),
        (statement(size=-1), "proof"),
        (statement(entry=5), "another form"),
        (statement(proof=5), "another form"),
        (statement(kind="mark3dgs-claim+jws"), "not as mark3dgs-registration"),
        (Attestation(LOG, statement().value[:-6] + "AAAAAA"), "no compact JWS|does not hold"),
        (Attestation(LOG, "rubbish"), "no compact JWS"),
        (Attestation("rfc3161", "?"), "base64"),
        (Attestation("rfc3161", ""), "no time stamp"),
    ],
)
def test_a_word_about_something_else_does_not_count(said: Attestation, text: str) -> None:
    witnesses, (note,) = check_attestations(attach(GOLDEN, said), Trust(jwks=JWKS))
    assert witnesses == ()
    assert re.search(text, note)


def test_what_is_no_attestation_is_refused() -> None:
    whole = attach(GOLDEN, statement())
    one = {"kind": LOG, "value": "a"}
    lists: list[Any] = [
        5,
        [5],
        [{}],
        [{**one, "more": 1}],
        [{**one, "kind": "oath"}],
        [{**one, "value": 5}],
        [one] * 99,
    ]
    texts = [json.dumps(each, separators=(",", ":"), sort_keys=True).encode() for each in lists]
    appendices = [APPENDED + struct.pack("<I", len(text)) + text for text in (*texts, b"{", b"[ ]")]
    for data in (whole[:-1], whole + b"x", GOLDEN + APPENDED, *(GOLDEN + appendix for appendix in appendices)):
        with pytest.raises(MalformedRecordError):
            read_attestations(data)
    with pytest.raises(MalformedRecordError, match="at most"):
        attach(GOLDEN, *(Attestation(LOG, str(number)) for number in range(MOST + 1)))


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the time stamps")
def test_a_stamp_counts_under_its_authority_and_for_its_record_only(tmp_path: Path) -> None:
    from engine.records.timestamps import make_query

    authority = Authority(tmp_path)
    stamp = stamp_of(authority.reply(make_query(public_bytes(GOLDEN))))
    (witness,), notes = check_attestations(attach(GOLDEN, stamp), Trust(authority.roots))
    assert notes == ()
    assert witness.at.startswith("20")
    assert "Test stamps" in witness.by
    none, (note,) = check_attestations(attach(GOLDEN, stamp), Trust())
    assert (none, "no certificate was given" in note) == ((), True)
    none, (note,) = check_attestations(attach(OTHER.to_bytes(KEY), stamp), Trust(authority.roots))
    assert (none, "something else" in note) == ((), True)
