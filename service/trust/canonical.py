"""One spelling of a JSON value (RFC 8785), so that its digest means the value and not its layout."""

import hashlib
from typing import Any

import rfc8785


def canonical(value: Any) -> bytes:
    """UTF-8 bytes of a JSON value in canonical form: sorted names, no spaces, one way to write each number.

    ValueError if it holds NaN, an infinity, an integer beyond 2^53, a lone surrogate or no JSON at all.
    """
    return rfc8785.dumps(value)


def digest(value: Any) -> str:
    """SHA-256 of the canonical form, hex."""
    return hashlib.sha256(canonical(value)).hexdigest()
