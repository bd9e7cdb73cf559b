"""A signed model: it reads as before to the last bit, costs a few kB, and says what the standard wants said."""

from __future__ import annotations

import io
import json
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID

from engine.credentials.manifest import ALG, EMBEDDED, binding_value, bound_record, describe, embedded_manifest
from engine.credentials.native import parse
from engine.credentials.reading import read_credentials
from engine.credentials.signer import Signer, make_trial_signer
from engine.credentials.signing import sign_into, sign_sidecar
from engine.errors import InputError
from engine.formats import read_model
from tests.credentials.conftest import RECORD, Desk
from tests.credentials.keys import KEYS, MAIL, chain_of, pem

MOST_ADDED = 20_000
"""Bytes that credentials may cost."""


def arrays(path: Path) -> dict[str, bytes]:
    """Every array of a model as its file gives it."""
    model = read_model(path).model
    return {name: getattr(model, name).tobytes() for name in ("means", "log_scales", "quats", "opacity_logits", "sh")}


def test_a_signed_sog_reads_as_before(files: dict[str, Path], desk: Desk, tmp_path: Path) -> None:
    signed = tmp_path / "signed.sog"
    made = sign_into(files["sog"], signed, RECORD, desk.signer)
    assert arrays(signed) == arrays(files["sog"])
    assert 0 < signed.stat().st_size - files["sog"].stat().st_size < MOST_ADDED
    with zipfile.ZipFile(files["sog"]) as before, zipfile.ZipFile(signed) as after:
        assert after.testzip() is None
        parts = before.namelist()
        assert [name for name in after.namelist() if not name.startswith("META-INF/")] == parts
        assert all(before.read(name) == after.read(name) for name in parts)
        assert after.getinfo(EMBEDDED).compress_type == zipfile.ZIP_STORED  # A.6.3
        assert after.read(EMBEDDED) == made.store


def test_what_the_manifest_says(files: dict[str, Path], desk: Desk, tmp_path: Path) -> None:
    signed = tmp_path / "signed.sog"
    made = sign_into(files["sog"], signed, RECORD, desk.signer)
    found = read_credentials(signed, "sog", desk.authority)
    assert found is not None
    assert (found.place, found.state, found.failures, found.id) == ("embedded", "Trusted", (), made.id)
    assert made.id.startswith("urn:c2pa:")
    assert (found.signer, found.issuer, found.algorithm) == ("Studio Acme", "Studio Acme", "Es256")
    assert found.generator.startswith("Mark3DGS ")
    assert found.actions == ("c2pa.opened", "c2pa.watermarked.bound")
    assert found.bindings == ((ALG, binding_value(RECORD)),)
    assert found.record_ids == [RECORD]
    assert found.signed_at == "", "no time stamp, no time"


def test_a_signer_that_nobody_vouches_for_is_not_trusted(files: dict[str, Path], desk: Desk, tmp_path: Path) -> None:
    signed = tmp_path / "signed.sog"
    sign_into(files["sog"], signed, RECORD, desk.signer)
    for anchors in ("", make_trial_signer("Studio Acme", 1)[1].decode()):  # one who only calls himself so
        found = read_credentials(signed, "sog", anchors)
        assert found is not None
        assert (found.state, found.failures) == ("Valid", ("signingCredential.untrusted",))


@pytest.mark.parametrize("kind", ["glb", "splat"])
def test_a_manifest_beside_the_model(kind: str, files: dict[str, Path], desk: Desk, tmp_path: Path) -> None:
    model = tmp_path / f"small.{kind}"
    model.write_bytes(files[kind].read_bytes())
    assert read_credentials(model, kind) is None
    (tmp_path / "small.c2pa").write_bytes(sign_sidecar(model, kind, RECORD, desk.signer).store)
    found = read_credentials(model, kind, desk.authority)
    assert found is not None
    assert (found.place, found.state, found.record_ids) == ("small.c2pa", "Trusted", [RECORD])
    assert model.read_bytes() == files[kind].read_bytes()
    model.write_bytes(model.read_bytes()[:-1] + b"\1")
    changed = read_credentials(model, kind, desk.authority)
    assert changed is not None
    assert (changed.state, "assertion.dataHash.mismatch" in changed.failures) == ("Invalid", True)


def test_nothing_secret_is_in_it(files: dict[str, Path], desk: Desk, tmp_path: Path) -> None:
    made = sign_into(files["sog"], tmp_path / "acme-for-initech.sog", RECORD, desk.signer)
    for word in (b"initech", b"acme-for", b"small", str(tmp_path).encode(), b"PRIVATE"):
        assert word not in made.store
    assert json.dumps(describe(RECORD)) == json.dumps(describe(RECORD)), "no clock and no chance of ours"


def test_the_value_of_a_binding() -> None:
    for record in (RECORD, "00" * 16, "fb" * 16, "ff" * 16):
        value = binding_value(record)
        variants = {value, value.rstrip("="), value.replace("+", " "), value.replace("+", "-").replace("/", "_")}
        assert {bound_record(each) for each in variants} == {record}
    for wrong in ("", "=", "AAAA", RECORD, value + "AAAA", "é" * 24, "!" * 24, "A" * 25):
        assert bound_record(wrong) == "", wrong


@pytest.mark.parametrize("algorithm", KEYS)
def test_every_kind_of_key_signs(algorithm: str, files: dict[str, Path], tmp_path: Path) -> None:
    key = KEYS[algorithm]()
    signer = Signer(chain_of(key, usages=MAIL), pem(key))
    assert signer.algorithm == algorithm
    made = sign_sidecar(files["glb"], "glb", RECORD, signer)
    found = parse(files["glb"], "model/gltf-binary", made.store)
    assert (found["state"], found["algorithm"].lower()) == ("Valid", algorithm)


def test_files_as_tools_write_them(files: dict[str, Path], tmp_path: Path) -> None:
    """OpenSSL's old form of a key, and what it says around certificates, in the letters of its user."""
    key = ec.generate_private_key(ec.SECP256R1())
    said = "Bag Attributes\n    friendlyName: Müller\n".encode("latin-1")
    old = key.private_bytes(Encoding.PEM, PrivateFormat.TraditionalOpenSSL, NoEncryption())
    signer = Signer(said + chain_of(key, usages=MAIL), said + old)
    assert (signer.chain + signer.key).isascii()
    assert sign_sidecar(files["glb"], "glb", RECORD, signer).id


def test_signers_that_are_none(desk: Desk) -> None:
    key, other = KEYS["es256"](), KEYS["es256"]()
    chain, weak = chain_of(key, usages=MAIL), rsa.generate_private_key(65537, 1024)
    bitcoin = ec.generate_private_key(ec.SECP256K1())
    for certificates, private, text in (
        (chain, pem(other), "does not belong"),
        (chain_of(key, usages=MAIL, begins=-9), pem(key), "is valid from"),
        (chain_of(key, usages=MAIL, begins=3), pem(key), "is valid from"),
        (desk.authority.encode(), pem(key), "does not belong"),
        (b"", pem(key), "no certificates in PEM"),
        (chain[:200], pem(key), "no certificates in PEM"),
        (chain, b"-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n", "no private key in PEM"),
        (chain, pem(key, b"secret"), "is encrypted"),
        (chain_of(weak, usages=MAIL), pem(weak), "neither"),
        (chain_of(bitcoin, usages=MAIL), pem(bitcoin), "neither"),
    ):
        with pytest.raises(InputError, match=text):
            Signer(certificates, private)


def test_a_certificate_for_another_purpose_signs_nothing(files: dict[str, Path], tmp_path: Path) -> None:
    key = KEYS["es256"]()
    signer = Signer(chain_of(key, usages=[ExtendedKeyUsageOID.TIME_STAMPING, *MAIL]), pem(key))
    with pytest.raises(InputError, match=r"signing failed|does not hold"):
        sign_into(files["sog"], tmp_path / "signed.sog", RECORD, signer)


def test_what_is_not_signed(files: dict[str, Path], desk: Desk, tmp_path: Path) -> None:
    signed = tmp_path / "signed.sog"
    sign_into(files["sog"], signed, RECORD, desk.signer)
    with pytest.raises(InputError, match="holds a manifest already"):
        sign_into(signed, tmp_path / "twice.sog", RECORD, desk.signer)
    with pytest.raises(InputError, match=r"no \.sog file"):
        sign_into(files["glb"], tmp_path / "glb.sog", RECORD, desk.signer)


def test_without_the_library(
    files: dict[str, Path], desk: Desk, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    signed = tmp_path / "signed.sog"
    sign_into(files["sog"], signed, RECORD, desk.signer)
    monkeypatch.setitem(sys.modules, "c2pa", None)
    with pytest.raises(InputError, match=r"pip install 'mark3dgs\[c2pa\]'"):
        sign_into(files["sog"], tmp_path / "other.sog", RECORD, desk.signer)
    blind = (
        sys.executable,
        "-c",
        "import sys; sys.modules['c2pa'] = None; import engine.credentials.process as p; p.main()",
    )
    monkeypatch.setattr("engine.credentials.reading._COMMAND", blind)
    found = read_credentials(signed, "sog")
    assert found is not None
    assert (found.state, "pip install" in found.reason) == ("Unread", True)


def test_a_trial_authority_issues_nothing_else(desk: Desk) -> None:
    """Its key is in no file, and its certificate lets it issue signers' alone."""
    authority = x509.load_pem_x509_certificate(desk.authority.encode())
    limits = authority.extensions.get_extension_for_class(x509.BasicConstraints).value
    assert (limits.ca, limits.path_length) == (True, 0)
    desk.signer.certificate.verify_directly_issued_by(authority)
    for name, days in (("", 1), ("a" * 65, 1), ("a\nb", 1), ("a", 0), ("a", 3651)):
        with pytest.raises(InputError):
            make_trial_signer(name, days)


def test_our_zip_reader_finds_what_c2pa_wrote(files: dict[str, Path], desk: Desk, tmp_path: Path) -> None:
    made = sign_into(files["sog"], tmp_path / "signed.sog", RECORD, desk.signer)
    assert embedded_manifest((tmp_path / "signed.sog").read_bytes(), "x") == made.store
    assert embedded_manifest(files["sog"].read_bytes(), "x") is None
    assert embedded_manifest(files["glb"].read_bytes(), "x") is None
    empty = io.BytesIO()
    zipfile.ZipFile(empty, "w").close()
    assert embedded_manifest(empty.getvalue(), "x") is None
    assert np.isfinite(read_model(tmp_path / "signed.sog").model.means).all()
