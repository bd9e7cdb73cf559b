"""Which false-claim rate a claim must meet: not the claimant's choice (DESIGN 4.9).

A record made after its owner saw the suspect can be the best of very many tried: 10^10 plans reach a bound of 10^-9 by
chance. So 10^-9 is enough only where a third party that attests the record contributed randomness to its chips, so that
records could not be tried out. Else the bound must be below 2^-128. That the suspect did not exist before the record is
what nobody can attest: a date since when it is known is the owner's word, and makes a condition, never a rate.
"""

from dataclasses import asdict, dataclass
from datetime import UTC, datetime

from engine.errors import InputError
from engine.numerics.plain import Json
from engine.watermark.statistics import CHANCE_RATE, DISHONEST_CLAIMANT_RATE

BASES = {
    "attested": "the registration is attested, and older than the suspect",
    "drawn": "the registration is attested, and the attesting service contributed randomness to the watermark",
    "self_declared": "the registration date is self-declared",
    "undated": "the registration is attested, but the date since when the suspect is known is missing",
    "dated": "the registration is attested; that the suspect is younger is the owner's own statement",
    "younger": "the suspect was known before the attested registration",
}
"""Why a rate applies."""

DEMANDS = {basis: CHANCE_RATE if basis in ("attested", "drawn") else DISHONEST_CLAIMANT_RATE for basis in BASES}
"""Largest rate that does, by its basis."""


@dataclass(frozen=True)
class Attested:
    """A third party's attestation of when a record existed. ValueError if `at` is no time."""

    at: str  # UTC, ISO 8601
    by: str  # who says so, for people
    # The attester drew a part of the plan, which decides the chips, when the reference and the key were settled:
    # many records could not be tried beforehand
    drawn: bool = False

    def __post_init__(self) -> None:
        _ = self.moment

    @property
    def moment(self) -> datetime:
        """The time, to compare."""
        return moment(self.at)

    def to_json(self) -> Json:
        """Plain values."""
        return asdict(self)


@dataclass(frozen=True)
class AppliedRate:
    """The rate that a claim must meet, and why."""

    rate: float
    basis: str  # a key of BASES
    # The rate that would do if the registration were attested and older than the suspect; None where the suspect is
    # known to be older
    if_attested: float | None
    condition: str = ""  # under which a bound between the two rates would be a claim


def applicable_rate(asked: float, attested: Attested | None, suspect_seen: str = "") -> AppliedRate:
    """The rate that applies to a record; what was asked for counts only where it is stricter.

    Parameters
    ----------
    asked : float
        In (0, 1).
    suspect_seen : str
        Since when the suspect is known, ISO 8601 (a date counts from its first moment); empty if unknown.
        InputError if it is no time.
    """
    usual = min(asked, CHANCE_RATE)
    basis = _basis(attested, suspect_seen)
    if basis == "younger":
        return AppliedRate(min(asked, DEMANDS[basis]), basis, None)
    condition = "a third party attested that the registration is older than the suspect"
    if basis == "dated":
        condition = f"the suspect did not exist before {suspect_seen}, which is the owner's word"
    return AppliedRate(min(asked, DEMANDS[basis]), basis, usual, condition)


def _basis(attested: Attested | None, suspect_seen: str) -> str:
    seen = _seen(suspect_seen) if suspect_seen else None
    if attested is None:
        return "self_declared"
    if seen is not None and seen <= attested.moment:
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


MADE_FIRST = Attested("1970-01-01T00:00:00+00:00", "whoever measures", drawn=True)
"""For measurements, whose records are older than their suspects."""
