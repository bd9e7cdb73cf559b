"""What a time-stamping service (RFC 3161) draws for a plan: a part of it that cannot be chosen or tried out at will.

1. All that the owner's layer follows from is settled: the plan. Its keyed digest are the *terms*.
2. A time-stamping service stamps the terms and the original's digest.
3. From the stamp's signature follows what is `drawn`, which enters the plan. The chips follow from that.

So each record that is tried out takes a request to that service (`rates.DRAWS`). The stamp is kept outside the plan: a
holder can change what its signature does not cover, and nothing of that may decide a chip.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from engine.errors import MalformedRecordError
from engine.numerics.plain import Json
from engine.records.attestation import Witness
from engine.records.header import make_draw_terms
from engine.records.record import Plan, Record
from engine.watermark.keys import OwnerKey

if TYPE_CHECKING:
    from cryptography import x509

DRAWN = "drawn"
"""Name of the commitment to what was drawn. In records without a stamp a service drew it by itself, and could have
tried records out."""
STAMPS = "stamps"
"""Name, outside the plan, of the stamps that drew for it, and before for plans that showed too much; the last is its
own."""


@dataclass(frozen=True, eq=False)
class Draw:
    """A time stamp from whose signature a part of the plan follows, and what was stamped: key, original and terms."""

    token: bytes  # reply of the time-stamping service, DER
    original: str  # SHA-256 of the owner's file, hex
    terms: str  # `make_draw_terms` of the whole plan but for what was drawn, hex

    @property
    def stamped(self) -> bytes:
        """What the stamp is about."""
        return draw_request(bytes.fromhex(self.original), bytes.fromhex(self.terms))

    def check(self, drawn: str, certificates: Sequence[x509.Certificate]) -> Witness:
        """Who drew, and when, if he whom these certificates vouch for drew this for these terms; else TimestampFault.

        What was drawn before its terms were settled would say nothing: the stamp is about them, and `drawn` follows
        from its signature.
        """
        from engine.records.timestamps import TimestampFault, authority_of, check_stamp, drawn_from

        if not certificates:
            raise TimestampFault("no certificate was given to trust its author by")
        at = check_stamp(self.token, self.stamped, certificates)
        if drawn_from(self.token) != drawn:
            raise TimestampFault("the plan holds something else than the time stamp draws")
        return Witness(at, authority_of(self.token))

    def to_json(self) -> Json:
        """Plain values, for who has the original's digest."""
        return {"token": base64.b64encode(self.token).decode(), "terms": self.terms}


def draw_request(original: bytes, terms: bytes) -> bytes:
    """What is stamped to draw for a plan: the SHA-256 of the owner's file, and `make_draw_terms`, 32 bytes each."""
    return b"mark3dgs draw\0" + original + terms


def terms_of(key: OwnerKey, reference_digest: bytes, plan: Plan) -> bytes:
    """What is stamped of a plan, 32 bytes: all that the owner's layer follows from but what is drawn for it."""
    shared = shared_values(plan[0])
    commitments = {name: text for name, text in shared.pop("commitments", {}).items() if name != DRAWN}
    return make_draw_terms(key, reference_digest, shared | {"commitments": commitments}, plan[1])


def shared_values(values: Mapping[str, Any]) -> Json:
    """A plan's JSON values but for which draw of the copy layer it is: the same in all copies of an asset."""
    return dict(values) | ({"copies": {**values["copies"], "draw": 0}} if "copies" in values else {})


def stamps_extra(stamps: Sequence[bytes]) -> Json:
    """How a record keeps the time stamps of its plans, outside the plan."""
    return {STAMPS: [base64.b64encode(each).decode() for each in stamps]} if stamps else {}


def stamps_in(record: Record) -> tuple[bytes, ...]:
    """The time stamps outside a record's plan; MalformedRecordError if they are none."""
    try:
        return tuple(base64.b64decode(each, validate=True) for each in record.extra.get(STAMPS, ()))
    except (TypeError, ValueError):
        raise MalformedRecordError("the record's time stamps are not written in base64") from None
