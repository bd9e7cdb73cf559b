"""Checking what the service signed (compact JWS, Ed25519) by the public keys of a trusted JWKS."""

import base64
import re
from collections.abc import Mapping
from typing import Any

from joserfc import jws
from joserfc.errors import JoseError
from joserfc.jwk import KeySet

ALGORITHM = "Ed25519"
CLAIM, REGISTRATION, DISPUTE = "mark3dgs-claim+jws", "mark3dgs-registration+jws", "mark3dgs-dispute+jws"
"""What may be signed, `typ` of the header: one is never taken for another."""

_COMPACT = re.compile(r"[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.([A-Za-z0-9_-]+)", re.ASCII)


class SignatureFault(Exception):
    """A signature that does not hold; the text says why."""


def verify(token: str, jwks: Mapping[str, Any], kind: str = CLAIM) -> tuple[bytes, str]:
    """Payload of a compact JWS of this kind, and the id of the key of the trusted `jwks` that signed it.

    SignatureFault where the signature does not hold.
    """
    match = _COMPACT.fullmatch(token)
    if match is None or not _one_spelling(match[1]):
        raise SignatureFault("this is no compact JWS")
    try:
        keys = KeySet.import_key_set({"keys": list(jwks["keys"])})
        found = jws.deserialize_compact(token, keys, [ALGORITHM])
    except (JoseError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SignatureFault(f"the signature does not hold: {error or type(error).__name__}") from None
    header = found.headers()
    if header.get("typ") != kind or set(header) != {"alg", "kid", "typ"}:
        raise SignatureFault(f"signed, but not as {kind}")
    return bytes(found.payload or b""), str(header["kid"])


def _one_spelling(text: str) -> bool:
    """Base64 leaves bits of a last character unused: only one spelling of a signature is taken."""
    try:
        plain = base64.urlsafe_b64decode(text + "=" * (-len(text) % 4))
    except ValueError:
        return False
    return base64.urlsafe_b64encode(plain).rstrip(b"=").decode() == text
