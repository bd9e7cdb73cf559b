"""Certificates and public keys that the user trusts, read from files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from engine.errors import InputError
from engine.numerics.plain import Json

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

    from engine.records.attestation import Attestation, Trust

TsaCertificates = Annotated[
    Path | None, typer.Option("--tsa-certificates", help="PEM certificates trusted to vouch for time stamps.")
]
TrustedList = Annotated[
    Path | None,
    typer.Option("--trusted-list", help="PEM certificates of a trusted list (eIDAS), for qualified time stamps."),
]
Jwks = Annotated[
    Path | None, typer.Option("--jwks", help="Public keys of a service whose log is trusted (/.well-known/jwks.json).")
]


def read_trust(certificates: Path | None, jwks: Path | None, listed: Path | None = None) -> Trust:
    """What the options name; nothing else is trusted."""
    from engine.records.attestation import Trust

    trusted, qualified = (read_certificates(each) if each is not None else [] for each in (certificates, listed))
    return Trust(trusted, qualified, read_jwks(jwks) if jwks is not None else {"keys": []})


def read_jwks(path: Path) -> Json:
    """Public keys (RFC 7517), or InputError."""
    from engine.formats.guards import read_small

    try:
        keys = json.loads(read_small(path), object_pairs_hook=_each_once)
        if keys["keys"] and all(isinstance(key, dict) and "kid" in key for key in keys["keys"]):
            return dict(keys)
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    raise InputError(f"{str(path)!r} is no set of public keys (JWKS)")


def read_certificates(path: Path) -> list[Certificate]:
    """Certificates in PEM, or InputError."""
    from cryptography.x509 import load_pem_x509_certificates

    from engine.formats.guards import read_small

    try:
        return load_pem_x509_certificates(read_small(path))
    except ValueError:
        raise InputError(f"{str(path)!r} holds no certificates in PEM") from None


def read_attestation(path: Path) -> Attestation:
    """A time-stamping service's reply (DER), or a service's signed statement of a registration (compact JWS)."""
    from engine.formats.guards import read_small
    from engine.records.attestation import LOG, Attestation, stamp_of

    data = read_small(path)
    text = data.decode("ascii", errors="replace").strip()
    return Attestation(LOG, text) if text.count(".") == 2 and text.isprintable() else stamp_of(data)


def _each_once(pairs: list[tuple[str, Any]]) -> Json:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a name occurs twice in one object")
    return found
