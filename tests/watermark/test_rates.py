"""Two rates: which applies follows from who says when a record was made, never from what its owner asks for."""

from __future__ import annotations

import math

import pytest

from engine.errors import InputError
from engine.watermark.rates import (
    ATTESTATION,
    BASES,
    DEMANDS,
    DRAWS,
    OWNER,
    Attested,
    Condition,
    ConditionKind,
    applicable_rate,
)
from engine.watermark.statistics import CHANCE_RATE, DISHONEST_CLAIMANT_RATE

STAMPED = Attested("2026-03-01T12:00:00+00:00", "a time-stamping service")
DRAWN = Attested("2026-03-01T12:00:00+00:00", "a service that drew", drawn=True)


@pytest.mark.parametrize(
    ("attested", "seen", "basis", "rate", "if_attested"),
    [
        (None, "", "self_declared", DISHONEST_CLAIMANT_RATE, CHANCE_RATE),
        (None, "2026-12-24", "self_declared", DISHONEST_CLAIMANT_RATE, CHANCE_RATE),
        (STAMPED, "2026-03-02", "dated", DISHONEST_CLAIMANT_RATE, CHANCE_RATE),
        # Whoever stamps a record after he tried ten thousand millions of them has a stamp, too.
        (STAMPED, "", "undated", DISHONEST_CLAIMANT_RATE, CHANCE_RATE),
        (STAMPED, "2026-03-01", "younger", DISHONEST_CLAIMANT_RATE, None),
        (STAMPED, "2026-03-01T12:00:00+00:00", "younger", DISHONEST_CLAIMANT_RATE, None),
        (STAMPED, "2026-03-01T14:00:00+02:00", "younger", DISHONEST_CLAIMANT_RATE, None),
        (STAMPED, "2026-03-01T12:00:01+00:00", "dated", DISHONEST_CLAIMANT_RATE, CHANCE_RATE),
        (DRAWN, "", "drawn", CHANCE_RATE, CHANCE_RATE),
        (DRAWN, "2020-01-01", "younger", DISHONEST_CLAIMANT_RATE, None),
    ],
)
def test_the_rate_follows_from_who_says_when(
    attested: Attested | None, seen: str, basis: str, rate: float, if_attested: float | None
) -> None:
    for asked in (0.999, 1e-3, 1e-9):
        found = applicable_rate(asked, attested, seen)
        assert (found.rate, found.basis, found.if_attested) == (rate, basis, if_attested)
        if seen:  # shown rather than said, it tells against a younger record, and for none
            shown = applicable_rate(asked, attested, suspect_existed=seen)
            assert shown.basis == ("younger" if basis == "younger" else applicable_rate(asked, attested).basis)
            assert applicable_rate(asked, attested, "2999-01-01", seen).if_attested == (
                None if basis == "younger" else if_attested
            )
    strict = applicable_rate(1e-50, attested, seen)
    assert strict.rate == 1e-50
    assert strict.basis == basis


def test_what_is_drawn_by_a_time_stamping_service_counts_its_requests() -> None:
    assert DRAWS == 2**20
    assert applicable_rate(1e-9, DRAWN).tries == DRAWS
    for attested, seen in ((None, ""), (STAMPED, ""), (STAMPED, "2026-03-02"), (DRAWN, "2020-01-01")):
        assert applicable_rate(1e-9, attested, seen).tries == 1


def test_conditions_say_what_by_when_and_who_vouches() -> None:
    """The owner's word is called that; a third party's is yet to come."""
    registered = Condition(ConditionKind.REGISTERED_BEFORE, None, ATTESTATION)
    since = Condition(ConditionKind.SUSPECT_SINCE, "2026-03-02", OWNER)
    for attested, seen, conditions in (
        (None, "", (registered,)),
        (None, "2026-12-24", (registered,)),
        (STAMPED, "", (registered,)),
        (STAMPED, "2026-03-02", (since,)),
        (STAMPED, "2026-03-01", ()),
        (DRAWN, "", ()),
    ):
        assert applicable_rate(1e-9, attested, seen).conditions == conditions
    said = since.to_json()
    assert (said["kind"], said["date"], said["by"]) == ("suspect_since", "2026-03-02", "owner")
    assert "2026-03-02" in said["text"]
    assert "the owner's word" in said["text"]


def test_dates_are_refused_in_words() -> None:
    for text in ("yesterday", "2026-13-01", "20"):
        with pytest.raises(InputError, match="no date"):
            applicable_rate(1e-9, STAMPED, text)
    with pytest.raises(ValueError, match="Invalid isoformat"):
        Attested("once upon a time", "grandmother")


def test_every_basis_has_its_words_and_its_demand() -> None:
    assert set(BASES) == set(DEMANDS)
    assert sorted(set(DEMANDS.values())) == [DISHONEST_CLAIMANT_RATE, CHANCE_RATE]
    assert math.log2(DISHONEST_CLAIMANT_RATE) == -128
