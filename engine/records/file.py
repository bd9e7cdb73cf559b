"""The record file: a public header and a sealed body.

Little-endian; everything before the sealed body is public and authenticated by it:

    magic 8s | version u16 | 0 u16 | header length u32 | body length u64 | sealed length u64
    header: canonical JSON
    sealed body: AES-SIV(zstd(body))
    SHA-256 of all before it
    attestations, if there are any (`engine.records.attestation`), which neither checksum nor seal covers

The checksum tells a damaged file from an altered one; the seal is what protects. AES-SIV (RFC 5297) is
deterministic: the same record gives the same bytes (with one version of zstd), and nothing is lost if one is
written twice.
"""

import struct
from hashlib import sha256

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESSIV

from engine.errors import InputError, MalformedRecordError, RecordTooNewError
from engine.formats import zstd
from engine.records.codec import canonical_json, parse_json
from engine.records.header import FIELDS, FORMAT_VERSION, RecordHeader, check_key
from engine.watermark.keys import RECORD_SEAL, OwnerKey

MEDIA_TYPE = "application/vnd.mark3dgs.record"
MAX_BODY_BYTES = (1 << 31) - (1 << 24)  # AES-SIV takes 2 GiB in one piece; the rest is zstd's worst case

APPENDED = b"M3DGSATT"
"""How attestations begin."""

MOST_UNPACKING = 64
"""Largest factor by which a body is longer than it lies in the file. Centres, rotations and descriptors are close to
noise: records of real scenes unpack to one to three times as many bytes."""

_FREE_BYTES = 1 << 20  # of a small record, which may be as regular as it likes

_MAGIC = b"M3DGSREC"
_PREFIX = struct.Struct("<8sHHIQQ")
_CHECKSUM_BYTES = 32
_TAG_BYTES = 16
_MAX_HEADER_BYTES = 4096
_SEAL_KEY_BYTES = 64  # AES-256-SIV: two keys of 32 bytes
_ZSTD_LEVEL = 1  # byte planes of near-random integers: higher levels gain 1 % at most


def seal(header: RecordHeader, body: bytes, key: OwnerKey) -> bytes:
    """The file of a header and a body.

    WrongKeyError if the key is not the one the header names; InputError if the body exceeds `MAX_BODY_BYTES`.
    """
    check_key(header, key)
    if len(body) > MAX_BODY_BYTES:
        raise InputError(f"a record of {len(body)} bytes exceeds the largest, {MAX_BODY_BYTES}")
    packed = zstd.compress(body, _ZSTD_LEVEL)
    text = canonical_json(header.to_json())
    sealed_length = _TAG_BYTES + len(packed)
    public = _PREFIX.pack(_MAGIC, header.format_version, 0, len(text), len(body), sealed_length) + text
    data = public + AESSIV(_seal_key(key, public)).encrypt(packed, [public])
    return data + sha256(data).digest()


def unseal(data: bytes, key: OwnerKey) -> tuple[RecordHeader, bytes]:
    """Header and body of a file.

    RecordTooNewError if a later version of this program wrote it; WrongKeyError if it is whole, but another key made
    it; MalformedRecordError if it is no record, was damaged or altered, or would unpack to more than `MAX_BODY_BYTES`.
    """
    data = split(data)[0]
    public, header, body_length = _open_public(data)  # 1. Whole, and of this version?
    check_key(header, key)  # 2. This key's?
    try:  # 3. Neither body nor header altered?
        packed = AESSIV(_seal_key(key, public)).decrypt(memoryview(data)[len(public) : -_CHECKSUM_BYTES], [public])
    except InvalidTag:
        raise MalformedRecordError("the record's seal is broken: it was altered") from None
    return header, _decompress(packed, body_length)


def read_header(data: bytes) -> RecordHeader:
    """Public header of a record file; needs no key, and says nothing about who sealed it.

    RecordTooNewError and MalformedRecordError as in `unseal`.
    """
    return _open_public(split(data)[0])[1]


def public_bytes(data: bytes) -> bytes:
    """Prefix and header of a record file, which name reference, plan, owner and original; errors as in `unseal`."""
    return _open_public(split(data)[0])[0]


def split(data: bytes) -> tuple[bytes, bytes]:
    """The record, and what follows it in the file."""
    if len(data) < _PREFIX.size:
        return data, b""
    *_, header_length, _, sealed_length = _PREFIX.unpack_from(data)
    end = _PREFIX.size + header_length + sealed_length + _CHECKSUM_BYTES
    return (data[:end], data[end:]) if data[end:].startswith(APPENDED) else (data, b"")


def _open_public(data: bytes) -> tuple[bytes, RecordHeader, int]:
    """Public bytes (prefix and header), header, and length of the body; the checksum holds."""
    if len(data) < _PREFIX.size or not data.startswith(_MAGIC):
        raise MalformedRecordError("this is no record")
    _, version, zero, header_length, body_length, sealed_length = _PREFIX.unpack_from(data)
    if version > FORMAT_VERSION:
        raise RecordTooNewError(f"the record is of format {version}, this program reads {FORMAT_VERSION}")
    public_length = _PREFIX.size + header_length
    if version < 1 or zero or header_length > _MAX_HEADER_BYTES or body_length > MAX_BODY_BYTES:
        raise MalformedRecordError("the record's prefix is malformed")
    if body_length > MOST_UNPACKING * sealed_length + _FREE_BYTES:
        text = f"of {sealed_length} bytes would unpack to {body_length}, over {MOST_UNPACKING} times as many"
        raise MalformedRecordError(f"the record's body {text}")
    if public_length + sealed_length + _CHECKSUM_BYTES != len(data) or sealed_length <= _TAG_BYTES:
        raise MalformedRecordError(f"the record was cut or extended: it has {len(data)} bytes")
    if sha256(memoryview(data)[:-_CHECKSUM_BYTES]).digest() != data[-_CHECKSUM_BYTES:]:
        raise MalformedRecordError("the record was damaged: its checksum does not match")
    fields = parse_json(data[_PREFIX.size : public_length], "the record's header")
    if not isinstance(fields, dict) or set(fields) != set(FIELDS):
        raise MalformedRecordError("the record's header is malformed")
    if fields["format_version"] != version:
        raise MalformedRecordError(
            f"the record's header is of format {fields['format_version']!r}, its file of {version}"
        )
    return data[:public_length], RecordHeader(**fields), body_length


def _decompress(packed: bytes, length: int) -> bytes:
    try:
        if zstd.content_size(packed) != length:  # before anything is allocated
            raise MalformedRecordError("the record's body is not as long as its header says")
        return zstd.decompress(packed, length)
    except zstd.ZstdError as error:
        raise MalformedRecordError("the record's body cannot be decompressed") from error


def _seal_key(key: OwnerKey, public: bytes) -> bytes:
    return key.derive(RECORD_SEAL, public, _SEAL_KEY_BYTES)
