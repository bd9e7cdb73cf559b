"""The public part of a record, and what binds the chips to the asset.

Chips follow from `chip_context`: the digest of the reference and the record id, and the id is a keyed hash of
the plan (code vectors, carriers, amplitudes, message, copy). Opening a record recomputes both. An invented
reference, or a plan fitted to given chips, gives other chips.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy.typing as npt

from engine.errors import MalformedRecordError, WrongKeyError
from engine.numerics.plain import Json
from engine.records.codec import packed_parts
from engine.watermark.keys import COPY_NAME, DRAW_TERMS, RECORD_CHECK, RECORD_ID, OwnerKey

FORMAT_VERSION = 3
"""Of records made here; those of 1 and 2 are read. 2 has the grain, and settles strengths before chips are drawn. 3 has
an owner's layer that all copies share, and one of the copy."""

HEX_LENGTHS = {
    "record_id": 32,
    "owner": 16,
    "reference_digest": 64,
    "original_digest": 64,
    "copy_digest": 32,
    "key_check": 32,
}
TEXT_FIELDS = ("registered_at", "tool_version")
FIELDS = (*HEX_LENGTHS, *TEXT_FIELDS, "format_version")

Arrays = Mapping[str, npt.NDArray[Any]]
Plan = tuple[Mapping[str, Any], Arrays]
"""What is settled before the chips are drawn, as a record keeps it: JSON values and arrays."""


def make_record_id(key: OwnerKey, reference: bytes, copy: str, plan: Mapping[str, Any], arrays: Arrays) -> bytes:
    """16-byte id of the record of one copy: a keyed hash of all that is settled before a chip is drawn.

    Parameters
    ----------
    reference : bytes
        `reference_digest` of the canonical reference, 32 bytes.
    copy : str
        Name of the copy (recipient); may be empty.
    plan, arrays
        As given to `Record.make`, equal to the last bit.
    """
    return key.derive(RECORD_ID, _settled(reference, copy, plan, arrays))[:16]


def make_draw_terms(key: OwnerKey, reference: bytes, plan: Mapping[str, Any], arrays: Arrays) -> bytes:
    """32 bytes that no other key, reference or plan gives, and that reveal none of these: what a time-stamping service
    that draws for a plan stamps together with the original's digest. Parameters as for `make_record_id`."""
    return key.derive(DRAW_TERMS, _settled(reference, "", plan, arrays))


def _settled(reference: bytes, copy: str, plan: Mapping[str, Any], arrays: Arrays) -> bytes:
    settled = sha256(b"mark3dgs plan\0" + reference)
    for part in packed_parts({"copy": copy, "plan": plan}, arrays):
        settled.update(part)
    return settled.digest()


def chip_context(reference: bytes, record_id: bytes) -> bytes:
    """Context of `OwnerKey.derive` for chips and assignment: reference digest (32), then record id (16).

    The binding makes a forged original useless: "marked model minus a mark of mine" changes the reference,
    hence the chips, hence the mark that should have been subtracted. It would take a fixed point of the hash.
    """
    if len(reference) != 32 or len(record_id) != 16:
        raise ValueError(f"expected 32 and 16 bytes, got {len(reference)} and {len(record_id)}")
    return reference + record_id


@dataclass(frozen=True)
class RecordHeader:
    """The public part of a record. All digests in lower-case hexadecimal."""

    record_id: str  # 32 digits, see `make_record_id`
    owner: str  # fingerprint of the owner key, 16 digits
    reference_digest: str  # SHA-256 of the canonical reference
    original_digest: str  # SHA-256 of the file the owner registered
    registered_at: str  # as the caller gave it, up to 64 printable ASCII characters; may be empty. No clock is read
    copy_digest: str  # 32 digits: keyed hash of the copy's name
    tool_version: str  # version of the program that made the record
    key_check: str  # 32 digits that only the right key reproduces
    format_version: int = FORMAT_VERSION  # version of the file format

    def __post_init__(self) -> None:
        for name, length in HEX_LENGTHS.items():
            value = getattr(self, name)
            if not isinstance(value, str) or len(value) != length or not set(value) <= set("0123456789abcdef"):
                raise MalformedRecordError(f"{name} of a record must be {length} hexadecimal digits: {value!r}")
        for name in TEXT_FIELDS:
            value = getattr(self, name)
            if not (isinstance(value, str) and len(value) <= 64 and value.isascii() and value.isprintable()):
                raise MalformedRecordError(f"{name} of a record must be up to 64 ASCII characters: {value!r}")
        if type(self.format_version) is not int or not 1 <= self.format_version <= FORMAT_VERSION:
            raise MalformedRecordError(f"a record of format {self.format_version!r} cannot be made here")

    def chip_context(self) -> bytes:
        """`chip_context` of this record."""
        return chip_context(bytes.fromhex(self.reference_digest), bytes.fromhex(self.record_id))

    def to_json(self) -> Json:
        """Plain dict of the fields."""
        return {name: getattr(self, name) for name in FIELDS}


def key_check(key: OwnerKey, record_id: bytes) -> str:
    """32 hexadecimal digits that tell a wrong key from a damaged record."""
    return key.derive(RECORD_CHECK, record_id)[:16].hex()


def copy_digest(key: OwnerKey, copy: str) -> str:
    """32 hexadecimal digits for the name of a copy: keyed, since names are easily guessed."""
    return key.derive(COPY_NAME, copy.encode())[:16].hex()


def check_key(header: RecordHeader, key: OwnerKey) -> None:
    """Raise WrongKeyError unless this key made the record."""
    if header.key_check != key_check(key, bytes.fromhex(header.record_id)):
        raise WrongKeyError(
            f"this key did not make this record: the key's fingerprint is {key.fingerprint}, the record names"
            f" {header.owner}"
        )
