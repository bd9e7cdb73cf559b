"""The signer: a certificate chain and its private key, both PEM; and a self-issued chain, for trials.

C2PA Technical Specification 2.4: 13.2 (algorithms), 14.5 (certificates).
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from engine.errors import InputError
from engine.formats.guards import read_small

Private = ec.EllipticCurvePrivateKey | ed25519.Ed25519PrivateKey | rsa.RSAPrivateKey

_PUBLIC = (Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
_CURVES = {"secp256r1": "es256", "secp384r1": "es384", "secp521r1": "es512"}
_LEAST_RSA_BITS = 2048
_SLACK = timedelta(minutes=5)
"""A clock that is a little behind finds a fresh certificate valid."""


@dataclass(frozen=True)
class Signer:
    """A chain (PEM, the signer's own certificate first) and its private key (PEM, not encrypted); both are kept without
    what else was in their files.

    InputError, on construction, where they are none, do not belong together, or are not valid now.
    """

    chain: bytes
    key: bytes

    def __post_init__(self) -> None:
        certificates, key = _certificates(self.chain), _private_key(self.key)
        own, public = certificates[0], key.public_key().public_bytes(*_PUBLIC)
        if own.public_key().public_bytes(*_PUBLIC) != public:
            raise InputError("the private key does not belong to the first certificate of the chain")
        now = datetime.now(UTC)
        if not own.not_valid_before_utc <= now <= own.not_valid_after_utc:
            first, last = own.not_valid_before_utc, own.not_valid_after_utc
            raise InputError(f"the certificate is valid from {first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M} UTC only")
        if own.issuer == own.subject:
            raise InputError("the certificate signs itself; C2PA accepts only certificates that another one issued")
        _algorithm(key)
        object.__setattr__(self, "chain", b"".join(each.public_bytes(Encoding.PEM) for each in certificates))
        object.__setattr__(self, "key", key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))

    @property
    def certificate(self) -> x509.Certificate:
        """The signer's own."""
        return _certificates(self.chain)[0]

    @property
    def algorithm(self) -> str:
        """As C2PA calls it: es256, es384, es512, ps256 or ed25519."""
        return _algorithm(_private_key(self.key))

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the chain, hexadecimal."""
        return sha256(self.chain).hexdigest()


def read_signer(certificates: Path, key: Path) -> Signer:
    """The signer whose chain and key are in these files; InputError names what is wrong with which."""
    chain, private = (read_small(path) for path in (certificates, key))
    try:
        return Signer(chain, private)
    except InputError as error:
        raise InputError(f"{str(certificates)!r} and {str(key)!r}: {error}") from None


def make_trial_signer(name: str, days: int) -> tuple[Signer, bytes]:
    """A self-made signer, and the certificate (PEM) of the authority that issued the signer's.

    To trust that authority is to trust the signer. Its key is thrown away: it issues nothing else.
    """
    if not 1 <= len(name) <= 64 or not name.isprintable():  # RFC 5280, A.1: ub-common-name
        raise InputError(f"the name must have 1 to 64 printable characters, got {name!r}")
    if not 1 <= days <= 3650:
        raise InputError(f"a certificate is made for 1 to 3,650 days, got {days}")
    root, own = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
    parts = NameOID.COMMON_NAME, NameOID.ORGANIZATION_NAME
    authority, subject = (
        x509.Name(map(x509.NameAttribute, parts, (common, name))) for common in ("Trial authority", name)
    )
    issued = _issue(authority, root, authority, root, days, of_authority=True)
    leaf = _issue(subject, own, authority, root, days, of_authority=False)
    private = own.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    return Signer(leaf.public_bytes(Encoding.PEM), private), issued.public_bytes(Encoding.PEM)


def _issue(
    subject: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    issuer: x509.Name,
    by: ec.EllipticCurvePrivateKey,
    days: int,
    *,
    of_authority: bool,
) -> x509.Certificate:
    now = datetime.now(UTC)
    usage = dict.fromkeys(
        (
            *("content_commitment", "key_encipherment", "data_encipherment", "key_agreement"),
            *("encipher_only", "decipher_only"),
        ),
        False,
    )
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _SLACK)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=of_authority, path_length=0 if of_authority else None), critical=True)
        .add_extension(
            x509.KeyUsage(
                digital_signature=not of_authority, key_cert_sign=of_authority, crl_sign=of_authority, **usage
            ),
            critical=True,
        )
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(by.public_key()), critical=False)
    )
    if not of_authority:  # one of those that 14.5.1 lets a signer have
        builder = builder.add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.EMAIL_PROTECTION]), critical=False)
    return builder.sign(by, hashes.SHA256())


def _certificates(pem: bytes) -> list[x509.Certificate]:
    try:
        found = x509.load_pem_x509_certificates(pem)
        for each in found:
            each.public_key()
    except (ValueError, x509.InvalidVersion, UnsupportedAlgorithm):
        raise InputError("the certificate chain holds no certificates in PEM, or some that cannot be read") from None
    return found


def _private_key(pem: bytes) -> Private:
    try:
        key = load_pem_private_key(pem, None)
    except TypeError:
        raise InputError("the private key is encrypted: give it without a password, in a file of mode 0600") from None
    except (ValueError, UnsupportedAlgorithm):
        raise InputError("the private key is no private key in PEM") from None
    if isinstance(key, Private):
        return key
    raise InputError("the private key is of a kind that C2PA does not take")


def _algorithm(key: Private) -> str:
    if isinstance(key, ec.EllipticCurvePrivateKey) and key.curve.name in _CURVES:
        return _CURVES[key.curve.name]
    if isinstance(key, ed25519.Ed25519PrivateKey):
        return "ed25519"
    if isinstance(key, rsa.RSAPrivateKey) and key.key_size >= _LEAST_RSA_BITS:
        return "ps256"
    raise InputError("the private key is neither P-256, P-384, P-521, Ed25519 nor RSA of 2,048 bits or more")
