"""Signatures: made under one key, checked with the public halves, and in one spelling only."""

from __future__ import annotations

import base64
import json
import string
from typing import Any

import pytest
from joserfc import jws
from joserfc.jwk import OctKey, OKPKey

from engine.records import signatures
from service.db import Database
from service.db.schema import signing_keys
from service.problems import Problem
from service.trust import signing
from service.trust.master import MasterKey

PAYLOAD = b'{"a":1}'


def signed(db: Database, master: MasterKey, payload: bytes = PAYLOAD) -> str:
    with db.read() as connection:
        return signing.sign(connection, master, payload)


def test_what_is_signed_is_verified(db: Database, master: MasterKey) -> None:
    kid = signing.ensure_key(db, master)
    assert signing.ensure_key(db, master) == kid
    assert signatures.verify(signed(db, master), signing.jwks(db)) == (PAYLOAD, kid)


def test_the_key_id_is_the_thumbprint_and_no_secret_is_published(db: Database, master: MasterKey) -> None:
    kid = signing.ensure_key(db, master)
    (public,) = signing.jwks(db)["keys"]
    assert set(public) == {"alg", "crv", "kid", "kty", "use", "x"}
    assert OKPKey.import_key({name: public[name] for name in ("crv", "kty", "x")}).thumbprint() == kid
    with db.read() as connection:
        row = connection.execute(signing_keys.select()).one()
    assert b'"d"' not in row.sealed


def test_after_a_rotation_old_signatures_hold(db: Database, master: MasterKey) -> None:
    old = signing.ensure_key(db, master)
    before = signed(db, master)
    new = signing.rotate(db, master)
    assert [key["kid"] for key in signing.jwks(db)["keys"]] == [new, old]
    assert signatures.verify(before, signing.jwks(db)) == (PAYLOAD, old)
    assert signatures.verify(signed(db, master), signing.jwks(db)) == (PAYLOAD, new)


def test_without_a_key_nothing_is_signed(db: Database, master: MasterKey) -> None:
    with pytest.raises(Problem, match="no signing key"):
        signed(db, master)


@pytest.fixture
def token(db: Database, master: MasterKey) -> tuple[str, dict[str, Any]]:
    signing.ensure_key(db, master)
    return signed(db, master), signing.jwks(db)


@pytest.mark.parametrize("settings", ["sqlite"], indirect=True)
def test_no_character_can_be_changed(token: tuple[str, dict[str, Any]]) -> None:
    """Every place, every other character of the alphabet: unused bits of base64 are no way round."""
    text, keys = token
    for spot, old in enumerate(text):
        others = string.ascii_letters + string.digits + "-_" if spot > len(text) - 3 else "Aa0-._=+ "
        for new in set(others) - {old}:
            with pytest.raises(signatures.SignatureFault):
                signatures.verify(text[:spot] + new + text[spot + 1 :], keys)
    for other in (text + "=", text + "\n", " " + text, text + ".", text[:-1], text.replace(".", "..", 1), ""):
        with pytest.raises(signatures.SignatureFault):
            signatures.verify(other, keys)


@pytest.mark.parametrize("settings", ["sqlite"], indirect=True)
def test_other_ways_to_sign_are_refused(db: Database, token: tuple[str, dict[str, Any]]) -> None:
    text, keys = token
    kid, header = keys["keys"][0]["kid"], {"typ": signatures.CLAIM}
    own = OKPKey.generate_key("Ed25519")
    public = base64.urlsafe_b64decode(keys["keys"][0]["x"] + "=")
    nothing = base64.urlsafe_b64encode(json.dumps({"alg": "none", "kid": kid, **header}).encode()).rstrip(b"=")
    forgeries = [
        jws.serialize_compact({"alg": "Ed25519", "kid": kid, **header}, PAYLOAD, own, ["Ed25519"]),
        jws.serialize_compact({"alg": "Ed25519", "kid": own.thumbprint(), **header}, PAYLOAD, own, ["Ed25519"]),
        jws.serialize_compact({"alg": "HS256", "kid": kid, **header}, PAYLOAD, OctKey.import_key(public), ["HS256"]),
        f"{nothing.decode()}.{text.split('.')[1]}.AAAA",
    ]
    for forged in forgeries:
        with pytest.raises(signatures.SignatureFault):
            signatures.verify(forged, keys)
    with pytest.raises(signatures.SignatureFault):
        signatures.verify(text, {"keys": []})


@pytest.mark.parametrize("settings", ["sqlite"], indirect=True)
def test_signed_for_another_purpose_is_no_claim(db: Database, master: MasterKey) -> None:
    kid = signing.ensure_key(db, master)
    with db.read() as connection:
        row = connection.execute(signing_keys.select()).one()
    private = OKPKey.import_key(json.loads(master.unseal(row.sealed, signing.bind("signing key", kid))))
    for extra in ({"typ": "JWT"}, {}, {"typ": signatures.CLAIM, "cty": "x"}):
        forged = jws.serialize_compact({"alg": "Ed25519", "kid": kid, **extra}, PAYLOAD, private, ["Ed25519"])
        with pytest.raises(signatures.SignatureFault, match="not as mark3dgs-claim"):
            signatures.verify(forged, signing.jwks(db))
