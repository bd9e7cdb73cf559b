"""What is drawn for the plans of one asset (`flows.records.draw`), one draw for all of its copies."""

from collections.abc import Callable
from dataclasses import dataclass

from engine.errors import InputError
from engine.flows.records.draw import DRAWN, draw_request, stamps_in, terms_of
from engine.records.record import Plan, Record
from engine.watermark.keys import OwnerKey

Stamp = Callable[[bytes], bytes]
"""Asks a time-stamping service for a stamp (reply, DER) of these bytes, and raises where there is none."""


@dataclass(frozen=True, eq=False)
class Draws:
    """Who draws for an asset: a time-stamping service; or, where copies of it are out, who drew for them."""

    original: str  # SHA-256 of the owner's file, hex
    stamp: Stamp | None = None  # None: nothing is drawn
    earlier: Record | None = None  # of a copy with which the owner's layer is shared

    def draw(self, key: OwnerKey, reference_digest: bytes, plan: Plan) -> tuple[str, bytes | None]:
        """What is drawn for a plan, "" for nothing, and the stamp from which it follows.

        InputError where an earlier copy's stamps are about other plans: it was made on other terms.
        """
        if self.earlier is None and self.stamp is None:
            return "", None
        if self.earlier is not None and not (known := stamps_in(self.earlier)):
            return dict(self.earlier.plan.get("commitments", {})).get(DRAWN, ""), None
        from engine.records.timestamps import drawn_from

        terms = terms_of(key, reference_digest, plan)
        if self.earlier is None:
            assert self.stamp is not None
            token = self.stamp(draw_request(bytes.fromhex(self.original), terms))
        else:
            token = self._known(known, draw_request(bytes.fromhex(self.earlier.header.original_digest), terms))
        return drawn_from(token), token

    def _known(self, stamps: tuple[bytes, ...], request: bytes) -> bytes:
        from engine.records.timestamps import TimestampFault, stamped_at

        assert self.earlier is not None
        for token in stamps:
            try:
                stamped_at(token, request)
            except TimestampFault:
                continue
            return token
        raise second_watermark(self.earlier)


def shares_layer(earlier: Record, reference_digest: bytes, key: OwnerKey) -> bool:
    """Whether copies of this reference must have the owner's layer of that record; before format 3 there was none."""
    return earlier.header.reference_digest == reference_digest.hex() and _has_layer(earlier, key)


def is_copy_of(earlier: Record, original_sha256: str, key: OwnerKey) -> bool:
    """Whether that record is of a copy of this file, with a layer that further copies must share."""
    return earlier.header.original_digest == original_sha256 and _has_layer(earlier, key)


def _has_layer(earlier: Record, key: OwnerKey) -> bool:
    return earlier.header.owner == key.fingerprint and earlier.header.format_version >= 3


def second_watermark(earlier: Record) -> InputError:
    """The refusal of another owner's layer on one model."""
    return InputError(f"this model was marked before (copy {earlier.copy!r}) with other settings: {SECOND_WATERMARK}")


SECOND_WATERMARK = (
    "two watermarks of yours on one model give each other away to anyone who compares the files. Use the same settings,"
    " message and program version, and a recipient's name for every copy or for none"
)
