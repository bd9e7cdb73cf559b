"""Checking attestations (`attestation`): which of them count for a record, and why others do not."""

import base64
import binascii
import json
from hashlib import sha256

import rfc8785

from engine.records.attestation import STAMP, Trust, Witness, header_digest, read_attestations
from engine.records.file import public_bytes, split
from engine.records.merkle import check_inclusion, leaf_hash
from engine.records.signatures import REGISTRATION, SignatureFault, verify
from engine.records.timestamps import TimestampFault, authority_of, check_stamp, qualification, stamped_at

ASSET_REGISTERED = "asset.registered"
"""Event of a log entry that registers a record."""


def check_attestations(data: bytes, trust: Trust) -> tuple[tuple[Witness, ...], tuple[str, ...]]:
    """Who attests the record, of those that the reader trusts; and notes on the others."""
    witnesses, notes = [], []
    for each in read_attestations(data):
        try:
            check = _check_stamp if each.kind == STAMP else _check_statement
            witnesses.append(check(each.value, data, trust))
        except (TimestampFault, SignatureFault) as fault:
            notes.append(f"an attestation does not count: {fault}")
    return tuple(witnesses), tuple(notes)


def _check_stamp(value: str, data: bytes, trust: Trust) -> Witness:
    try:
        token = base64.b64decode(value, validate=True)
    except binascii.Error:
        raise TimestampFault("a time stamp is not written in base64") from None
    stamped = public_bytes(data)
    if not trust.certificates:
        at = stamped_at(token, stamped)
        raise TimestampFault(f"a stamp of {at} is there, but no certificate was given to trust its author by")
    at, kind = check_stamp(token, stamped, trust.certificates), qualification(token, trust.listed)
    return Witness(at, f"{authority_of(token)}, by {kind}" if kind else authority_of(token))


def _check_statement(value: str, data: bytes, trust: Trust) -> Witness:
    if not trust.jwks["keys"]:
        raise SignatureFault("a service's log attests it, but no public key was given to trust the service by")
    payload, kid = verify(value, trust.jwks, REGISTRATION)
    try:
        said = json.loads(payload)
        entry, bound = said["entry"], said["header_sha256"]
        steps, root = [bytes.fromhex(step) for step in said["proof"]], bytes.fromhex(said["root"])
        included = check_inclusion(leaf_hash(rfc8785.dumps(entry)), entry["index"], said["size"], steps, root)
        event, at = entry["event"], str(entry["at"])
        logged = entry["payload"]["record_sha256"] == sha256(split(data)[0]).hexdigest()
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise SignatureFault("a service's statement of a registration has another form") from None
    if bound != header_digest(data) or event != ASSET_REGISTERED or not logged:
        raise SignatureFault("a service's word is about another record")
    if not included:
        raise SignatureFault("the log's proof of the registration does not lead to its root")
    return Witness(at, f"the log of the service with the key {kid}")
