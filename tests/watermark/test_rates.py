"""Two rates: which applies follows from who says when a record was made, never from what its owner asks for."""

from __future__ import annotations

import math

import pytest

from engine.errors import InputError
from engine.watermark.rates import BASES, DEMANDS, Attested, applicable_rate
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
    strict = applicable_rate(1e-50, attested, seen)
    assert strict.rate == 1e-50
    assert strict.basis == basis


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
