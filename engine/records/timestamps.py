"""Time stamps (RFC 3161): a third party's proof that bytes, such as a record's header, existed at a time."""

import hashlib
import time
import urllib.request
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC
from http.client import HTTPException

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import utils
from rfc3161_client import (
    HashAlgorithm,
    PKIStatus,
    TimeStampRequest,
    TimestampRequestBuilder,
    TimeStampResponse,
    VerifierBuilder,
    decode_timestamp_response,
)

from engine.errors import InputError

SECONDS = 10.0
"""How long a time-stamping service may take to answer, and to send its answer."""
MOST_BYTES = 64 * 1024

_OCTETS, _OID, _SEQUENCE, _SET = 0x04, 0x06, 0x30, 0x31  # tags of DER
_QC_STATEMENTS = x509.ObjectIdentifier("1.3.6.1.5.5.7.1.3")
_QC_COMPLIANCE = bytes.fromhex("04008e460101")  # id-etsi-qcs-QcCompliance, 0.4.0.1862.1.1, in DER


class TimestampFault(Exception):
    """A time stamp that was not given, or does not hold; the text says why."""


@dataclass(frozen=True)
class Stamped:
    """The result of a request: the service's reply (DER), or why there is none."""

    token: bytes | None
    failure: str = ""


def make_query(data: bytes) -> bytes:
    """A query (DER) for a time stamp of the SHA-256 of these bytes, to be sent by any means."""
    query: bytes = _query(data).as_bytes()
    return query


def stamp(url: str, data: bytes) -> Stamped:
    """A time stamp of the SHA-256 of these bytes, from the service at an http(s) address. Never raises: a claim stands
    without it."""
    try:
        request = _query(data)
        reply = _ask(url, request.as_bytes())
        response = _read(reply)
        if response.tst_info.nonce != request.nonce:
            raise TimestampFault("the reply answers another request")
        _check_digest(response, data)
        return Stamped(reply)
    except (TimestampFault, OSError, HTTPException, ValueError) as error:
        return Stamped(None, f"no time stamp: {error or type(error).__name__}")


def require_stamp(url: str, data: bytes) -> bytes:
    """As `stamp`: the reply (DER). InputError where there is none."""
    stamped = stamp(url, data)
    if stamped.token is None:
        raise InputError(stamped.failure)
    return stamped.token


def stamped_at(token: bytes, data: bytes) -> str:
    """The time a stamp of these bytes names, UTC, ISO 8601; its author is not checked. TimestampFault if it is none."""
    response = _read(token)
    _check_digest(response, data)
    return response.tst_info.gen_time.replace(tzinfo=UTC).isoformat(timespec="seconds")


def check_stamp(token: bytes, data: bytes, roots: Sequence[x509.Certificate]) -> str:
    """As `stamped_at`, for a stamp whose signer one of these certificates vouches for."""
    at = stamped_at(token, data)
    response = _read(token)
    try:
        builder = VerifierBuilder(roots=list(roots))
        for raw in response.signed_data.certificates:
            certificate = x509.load_der_x509_certificate(raw)
            if not _stamps_time(certificate) and certificate not in roots:
                builder = builder.add_intermediate_certificate(certificate)
        builder.build().verify_message(response, data)
    except Exception as error:  # parsers of foreign certificates raise many kinds; whichever it is, it does not hold
        raise TimestampFault(f"the time stamp's signature does not hold: {error}") from None
    return at


def drawn_from(token: bytes) -> str:
    """64 hexadecimal digits that a time stamp draws: they follow from its signature, and from nothing else in it.

    The holder of a stamp can change what the signature does not cover: unsigned attributes, certificates, revocation
    lists, algorithm names, the reply's status. None of it enters, not even to tell the kind of signature. Where (r, s)
    is a signature by ECDSA, (r, n - s) is one, too, which anybody can make: r alone enters. A verifier takes one
    spelling of a number, and of an RSA signature there is one. So other digits take another request to the service.

    TimestampFault if it is no stamp with one signature; whether that holds, and whose it is, `check_stamp` says.
    """
    response = _read(token)
    try:
        signature = _signature(response.time_stamp_token())
    except (ValueError, IndexError) as error:
        raise TimestampFault(f"the time stamp's signature cannot be read: {error}") from None
    try:
        drawn = b"ecdsa\0%x" % utils.decode_dss_signature(signature)[0]
    except ValueError:  # no two numbers in DER
        drawn = b"plain\0" + signature
    return hashlib.sha256(b"mark3dgs draw\0" + drawn).hexdigest()


def _signature(token: bytes) -> bytes:
    """The signature in a ContentInfo of SignedData (RFC 5652): one signer's, else ValueError."""
    (content,) = _parts(token, _SEQUENCE)
    _, wrapped = _parts(content[1])
    (signed,) = _parts(wrapped[1])
    tag, signers = _parts(signed[1])[-1]
    if tag != _SET:
        raise ValueError("no signers")
    (signer,) = _parts(signers, _SEQUENCE)
    (signature,) = (value for tag, value in _parts(signer[1]) if tag == _OCTETS)
    return signature


def _parts(data: bytes, only: int | None = None) -> list[tuple[int, bytes]]:
    """Tag and content of each DER value in turn; the library has read them all, so lengths are well-formed."""
    found, at = [], 0
    while at < len(data):
        tag, length, at = data[at], data[at + 1], at + 2
        if length & 0x80:
            width = length & 0x7F
            length, at = int.from_bytes(data[at : at + width], "big"), at + width
        if at + length > len(data) or only not in (None, tag):
            raise ValueError("it has another form")
        found.append((tag, data[at : at + length]))
        at += length
    return found


def _query(data: bytes) -> TimeStampRequest:
    return TimestampRequestBuilder().data(data).hash_algorithm(HashAlgorithm.SHA256).build()


def _ask(url: str, query: bytes) -> bytes:
    if not url.startswith(("http://", "https://")):
        raise TimestampFault(f"{url!r} is no http address")
    headers = {"Content-Type": "application/timestamp-query", "Accept": "application/timestamp-reply"}
    request = urllib.request.Request(url, query, headers)
    until = time.monotonic() + SECONDS
    parts, total = [], 0
    with urllib.request.urlopen(request, timeout=SECONDS) as reply:
        while part := reply.read1(MOST_BYTES):
            parts.append(part)
            total += len(part)
            if total > MOST_BYTES:
                raise TimestampFault(f"the reply is longer than {MOST_BYTES} bytes")
            if time.monotonic() > until:
                raise TimestampFault(f"the reply took longer than {SECONDS:g} seconds")
    return b"".join(parts)


def authority_of(token: bytes) -> str:
    """Name of the authority that issued a stamp, as its certificate has it."""
    certificate = _signer(token)
    return (
        "a time-stamping service without a certificate" if certificate is None else certificate.subject.rfc4514_string()
    )


def qualification(token: bytes, listed: Sequence[x509.Certificate]) -> str:
    """Whether a stamp that `check_stamp` took is a qualified one (Regulation (EU) 910/2014, eIDAS, article 42), in
    words; "" where no certificates `listed` on a trusted list are given to tell it by.

    Its signer's certificate must state that it is qualified (qcStatements, ETSI EN 319 412-5), and be listed itself or
    issued by one that is.
    """
    certificate = _signer(token)
    if not listed:
        return ""
    if certificate is None or not _states_qualified(certificate):
        return "a plain time stamp: its certificate does not state that it is qualified (eIDAS)"
    if certificate not in listed and not any(_issued(certificate, each) for each in listed):
        return "a plain time stamp: its certificate is neither on the trusted list (eIDAS) nor issued by one that is"
    return "a qualified time stamp (eIDAS)"


def _signer(token: bytes) -> x509.Certificate | None:
    """The certificate that the signature names: others in a stamp are not covered by it, and anyone can add some."""
    signed = _read(token).signed_data
    if len(signed.signer_infos) != 1:
        return None
    (signer,) = signed.signer_infos
    for raw in signed.certificates:
        certificate = x509.load_der_x509_certificate(raw)
        if (certificate.issuer, certificate.serial_number) == (signer.issuer, signer.serial_number):
            return certificate
    return None


def _states_qualified(certificate: x509.Certificate) -> bool:
    try:
        stated = certificate.extensions.get_extension_for_oid(_QC_STATEMENTS).value.public_bytes()
        (statements,) = _parts(stated, _SEQUENCE)
        return any(_parts(each)[0] == (_OID, _QC_COMPLIANCE) for _, each in _parts(statements[1], _SEQUENCE))
    except (x509.ExtensionNotFound, ValueError, IndexError):
        return False


def _issued(certificate: x509.Certificate, issuer: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(issuer)
        return True
    except (ValueError, TypeError, InvalidSignature):
        return False


def _read(token: bytes) -> TimeStampResponse:
    try:
        response = decode_timestamp_response(token)
        if response.status != PKIStatus.GRANTED:
            raise TimestampFault(f"refused: {', '.join(response.status_string) or response.status}")
        _ = response.tst_info, response.signed_data  # both are parsed on access
    except ValueError as error:
        raise TimestampFault(f"this is no time stamp: {error}") from None
    return response


def _check_digest(response: TimeStampResponse, data: bytes) -> None:
    if response.tst_info.message_imprint.message != hashlib.sha256(data).digest():
        raise TimestampFault("the time stamp is one of something else")


def _stamps_time(certificate: x509.Certificate) -> bool:
    try:
        usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    except x509.ExtensionNotFound:
        return False
    return x509.oid.ExtendedKeyUsageOID.TIME_STAMPING in usage
