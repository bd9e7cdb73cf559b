"""Opening a record together with what others say of it."""

from dataclasses import replace
from hashlib import sha256

from engine.flows.records.opened_record import DRAWN, OpenedRecord, open_record
from engine.records.attestation import Trust, Witness, read_attestations
from engine.watermark.keys import OwnerKey
from engine.watermark.rates import Attested

__all__ = ["attested_by", "open_attested"]


def open_attested(data: bytes, key: OwnerKey, trust: Trust) -> tuple[OpenedRecord, tuple[str, ...]]:
    """A record, attested by whom the reader trusts, and what is to be said of other attestations.

    Errors are those of `open_record`; a record whose attestations do not count is opened all the same.
    """
    witnesses: tuple[Witness, ...] = ()
    notes: tuple[str, ...] = ()
    if read_attestations(data):
        from engine.records.witnessing import check_attestations  # certificates take a tenth of a second to import

        witnesses, notes = check_attestations(data, trust)
    opened = open_record(data, key)
    return replace(opened, attested=attested_by(opened, witnesses)), notes


def attested_by(opened: OpenedRecord, witnesses: tuple[Witness, ...]) -> Attested | None:
    """The word that counts most: of one who drew a part of the plan, then the earliest."""
    own = opened.commitments.get(DRAWN, "")
    digest = sha256(own.encode()).hexdigest() if own else "nothing was drawn"
    words = [Attested(each.at, each.by, each.drawn_sha256 == digest) for each in witnesses]
    return min(words, key=lambda word: (not word.drawn, word.moment), default=None)
