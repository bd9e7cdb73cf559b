"""Attestations: third parties' statements that a record existed at a time, kept in its file after the seal.

They come after the record is sealed, so the seal does not cover them; each is bound to the record by the SHA-256 of its
public bytes (prefix and header), which name reference, plan, owner and original. Appended to the record, little-endian:

    magic 8s | length u32 | canonical JSON: a list of {"kind", "value"}

kind "rfc3161": the reply of a time-stamping service about the public bytes, base64. Kind "log": a service's signed word
that it registered the record (compact JWS): {"header_sha256", "entry", "index", "size", "root", "proof"}, the entry
being one of its audit log, proven to be under the root (RFC 6962).

An attestation counts only where the reader trusts its author, by certificates or public keys of his own.
"""

from __future__ import annotations

import base64
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from typing import TYPE_CHECKING, Any

from engine.errors import MalformedRecordError
from engine.records.codec import canonical_json, parse_json
from engine.records.file import APPENDED, public_bytes, split

if TYPE_CHECKING:
    from cryptography import x509

STAMP, LOG = "rfc3161", "log"
MOST = 16
"""Attestations of one record."""

_HEAD = struct.Struct("<8sI")
_MAX_BYTES = 1 << 20


@dataclass(frozen=True)
class Attestation:
    """One statement about a record, not yet checked."""

    kind: str  # STAMP or LOG
    value: str  # base64 of a time-stamping service's reply, or a compact JWS


@dataclass(frozen=True)
class Trust:
    """Authorities that a reader trusts."""

    certificates: Sequence[x509.Certificate] = ()  # that vouch for time-stamping services
    listed: Sequence[x509.Certificate] = ()  # on a trusted list (eIDAS): they tell qualified stamps from plain ones
    jwks: Mapping[str, Any] = field(default_factory=lambda: {"keys": []})  # public keys of services with a log


@dataclass(frozen=True)
class Witness:
    """An attestation that was checked."""

    at: str  # UTC, ISO 8601
    by: str  # who says so, for people


def read_attestations(data: bytes) -> tuple[Attestation, ...]:
    """Attestations in a record file; MalformedRecordError if what follows the record is something else."""
    appendix = split(data)[1]
    if not appendix:
        return ()
    magic, length = _HEAD.unpack_from(appendix) if len(appendix) >= _HEAD.size else (b"", 0)
    if magic != APPENDED or length > _MAX_BYTES or _HEAD.size + length != len(appendix):
        raise MalformedRecordError("what follows the record was cut or extended: it is no attestation")
    found = parse_json(appendix[_HEAD.size :], "the record's attestation")
    if not isinstance(found, list) or len(found) > MOST:
        raise MalformedRecordError(f"a record has at most {MOST} attestations")
    for each in found:
        if not isinstance(each, dict) or set(each) != {"kind", "value"} or not isinstance(each["value"], str):
            raise MalformedRecordError("an attestation of the record is malformed")
        if each["kind"] not in (STAMP, LOG):
            raise MalformedRecordError(f"an attestation of kind {each['kind']!r} is unknown here")
    return tuple(Attestation(**each) for each in found)


def attach(data: bytes, *more: Attestation) -> bytes:
    """The record file with further attestations; what it has already is not added again."""
    kept = tuple(dict.fromkeys((*read_attestations(data), *more)))
    text = canonical_json([{"kind": each.kind, "value": each.value} for each in kept])
    if len(kept) > MOST or len(text) > _MAX_BYTES:
        raise MalformedRecordError(f"a record has at most {MOST} attestations of {_MAX_BYTES} bytes together")
    return split(data)[0] + _HEAD.pack(APPENDED, len(text)) + text


def stamp_of(token: bytes) -> Attestation:
    """A time-stamping service's reply (DER), as an attestation."""
    return Attestation(STAMP, base64.b64encode(token).decode())


def header_digest(data: bytes) -> str:
    """SHA-256 of a record's public bytes, hex: what attestations are bound to."""
    return sha256(public_bytes(data)).hexdigest()
