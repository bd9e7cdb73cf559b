"""Which false-claim rate a claim must meet: not the claimant's choice (DESIGN 4.9).

A record made after its owner saw the suspect can be the best of very many tried: 10^10 plans reach a bound of 10^-9 by
chance. So 10^-9 is enough only where the chips follow from a time-stamping service's signature over the plan, so that
each record that is tried out takes a request to that service; DRAWS requests are counted as hypotheses. Else the bound
must be below 2^-128. That the suspect did not exist before the record cannot be attested: a date since when it
is known is the owner's word, and makes a condition, never a rate.
"""

from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum

from engine.errors import InputError
from engine.numerics.plain import Json
from engine.watermark.statistics import CHANCE_RATE, DISHONEST_CLAIMANT_RATE

BASES = {
    "attested": "the registration is attested, and older than the suspect",
    "drawn": "the registration is attested, and a time-stamping service's signature contributed to the watermark",
    "self_declared": "the registration date is self-declared",
    "undated": "the registration is attested, but no time-stamping service drew a part of the watermark",
    "dated": "the registration is attested; that the suspect is younger is the owner's own statement",
    "younger": "the suspect was known before the attested registration",
}
"""Why a rate applies."""

DEMANDS = {basis: CHANCE_RATE if basis in ("attested", "drawn") else DISHONEST_CLAIMANT_RATE for basis in BASES}
"""Largest rate that does, by its basis. `attested` is of claims before version 4 alone."""

DRAWS = 1 << 20
"""Records that may have been tried out where a time-stamping service drew: each takes a request to it."""


class ConditionKind(StrEnum):
    """What is to be shown for a bound between the two rates to be a claim."""

    REGISTERED_BEFORE = "registered_before"  # the registration is older than the suspect
    SUSPECT_SINCE = "suspect_since"  # the suspect did not exist before a date


OWNER, ATTESTATION = "owner", "attestation"
"""Who vouches for a condition: the owner's word, or an attestation that does not exist yet."""


@dataclass(frozen=True)
class Condition:
    """Under which a bound between the two rates would be a claim."""

    kind: ConditionKind
    date: str | None  # of SUSPECT_SINCE, ISO 8601
    by: str  # who vouches for it: OWNER or ATTESTATION

    @property
    def text(self) -> str:
        """In words."""
        if self.kind is ConditionKind.REGISTERED_BEFORE:
            return "the registration is older than the suspect, which nobody has attested"
        return f"the suspect did not exist before {self.date}, which is the owner's word"

    def to_json(self) -> Json:
        """Plain values, with the words."""
        return {"kind": self.kind.value, "date": self.date, "by": self.by, "text": self.text}


@dataclass(frozen=True)
class Attested:
    """A third party's attestation of when a record existed. ValueError if `at` is no time."""

    at: str  # UTC, ISO 8601
    by: str  # who says so, for people
    # The chips follow from a time-stamping service's signature over key, original and plan, which was checked: records
    # could be tried out by asking it only
    drawn: bool = False

    def __post_init__(self) -> None:
        _ = self.moment

    @property
    def moment(self) -> datetime:
        """The time, to compare."""
        return moment(self.at)

    def to_json(self) -> Json:
        """Plain values."""
        return {"at": self.at, "by": self.by, "drawn": self.drawn}


@dataclass(frozen=True)
class AppliedRate:
    """The rate that a claim must meet, and why."""

    rate: float
    basis: str  # a key of BASES
    # The rate that would do if the registration is older than the suspect; None where the suspect is known to be older
    if_attested: float | None
    conditions: tuple[Condition, ...] = ()  # under which a bound between the two rates would be a claim
    tries: int = 1  # records that may have been tried out, each a hypothesis


def applicable_rate(
    wanted: float, attested: Attested | None, suspect_seen: str = "", suspect_existed: str = ""
) -> AppliedRate:
    """The rate that applies to a record; the wanted rate counts only where it is stricter.

    Parameters
    ----------
    wanted : float
        In (0, 1).
    suspect_seen : str
        Since when the suspect is known, ISO 8601 (a date counts from its first moment); empty if unknown.
        InputError if it is no time.
    suspect_existed : str
        By when the suspect is shown to have existed, ISO 8601; empty if that is not shown. It counts only against a
        record that is younger: that the suspect did not exist before cannot be shown.
    """
    usual = min(wanted, CHANCE_RATE)
    basis = _basis(attested, suspect_seen, suspect_existed)
    if basis == "younger":
        return AppliedRate(min(wanted, DEMANDS[basis]), basis, None)
    tries = DRAWS if basis == "drawn" else 1
    return AppliedRate(min(wanted, DEMANDS[basis]), basis, usual, conditions_of(basis, suspect_seen), tries)


def conditions_of(basis: str, suspect_seen: str = "") -> tuple[Condition, ...]:
    """What a bound between the two rates waits for, by the basis of the rate that applies."""
    if basis == "dated":
        return (Condition(ConditionKind.SUSPECT_SINCE, suspect_seen, OWNER),)
    if basis in ("self_declared", "undated"):
        return (Condition(ConditionKind.REGISTERED_BEFORE, None, ATTESTATION),)
    return ()


def _basis(attested: Attested | None, suspect_seen: str, suspect_existed: str) -> str:
    seen, existed = (_seen(text) if text else None for text in (suspect_seen, suspect_existed))
    if attested is None:
        return "self_declared"
    if any(known is not None and known <= attested.moment for known in (seen, existed)):
        return "younger"
    if attested.drawn:
        return "drawn"
    return "dated" if seen is not None else "undated"


def _seen(text: str) -> datetime:
    try:
        return moment(text)
    except ValueError:
        raise InputError(f"{text!r} is no date: write 2026-11-03 or 2026-11-03T09:14:07+00:00") from None


def moment(text: str) -> datetime:
    """A time to compare, of ISO 8601 text; without a zone it is UTC. ValueError if it is none."""
    found = datetime.fromisoformat(text)
    return found if found.tzinfo is not None else found.replace(tzinfo=UTC)


MADE_FIRST = Attested("1970-01-01T00:00:00+00:00", "the measurement", drawn=True)
"""For measurements, as if a time-stamping service had drawn: the lowest demand that a record can meet."""
