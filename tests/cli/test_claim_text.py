"""The words of a claim: nothing overstated, every verdict explained."""

import pytest

from engine.cli.claim_text import WIDTH, claim_lines, odds, percent, surely


def report(verdict: str, **changes: object) -> dict[str, object]:
    base: dict[str, object] = {
        "verdict": verdict,
        "message": "c0ffee42",
        "matching_bits": 32,
        "bits": 32,
        "bit_reliability": [1.0] * 32,
        "log10_false_claim": -612.4,
        "false_claim_rate": 1e-9,
        "power": 1.0,
        "missing": "",
        "derived_fraction": 0.248,
        "derived_but_unmarked": False,
        "transform": None,
        "route": "model",
        "copy": "acme",
        "notes": [],
        "meets_dishonest_claimant_rate": True,
        "record_id": "ab" * 16,
        "owner": "cd" * 8,
        "registered_at": "",
    }
    return base | changes


@pytest.mark.parametrize(
    ("log10", "text"),
    [
        (-612.4, "at most 1 in 10^612"),
        (-9.0, "at most 1 in 10^9"),
        (-1.99, "at most 1 in 10^1"),
        (-0.5, "no better than chance"),
        (0.0, "no better than chance"),
    ],
)
def test_odds_are_rounded_against_the_claim(log10: float, text: str) -> None:
    assert odds(log10) == text


@pytest.mark.parametrize(
    ("share", "text"), [(1.0, "100 %"), (0.99999, "more than 99.9 %"), (0.248, "24.8 %"), (0.0, "0.0 %")]
)
def test_only_the_whole_is_a_hundred_percent(share: float, text: str) -> None:
    assert percent(share) == text


def test_nothing_measured_is_certain() -> None:
    assert surely(1.0) == "more than 99.9 %"
    assert surely(0.502) == "50.2 %"


def test_a_marked_claim_says_all_of_it() -> None:
    text = "\n".join(claim_lines(report("marked"), "suspect.ply"))
    for part in (
        "MARKED: the mark of this record is in suspect.ply",
        "c0ffee42",
        "32 of 32",
        "1 in 10^612",
        "asked for: at most 1 in 10^9",
        "24.8 %",
        "'acme'",
        "ab" * 16,
        "proven bound",
        "does not mean",
        "2^-128",
    ):
        assert part in " ".join(text.split()), part


def test_a_weak_claim_says_that_the_date_matters() -> None:
    text = " ".join(claim_lines(report("marked", meets_dishonest_claimant_rate=False), "s"))
    assert "known to be older" in text


def test_derived_but_unmarked_is_its_own_finding() -> None:
    text = " ".join(claim_lines(report("not_marked", derived_but_unmarked=True, log10_false_claim=0.0), "s"))
    assert "this asset is in s, but not this mark" in text
    assert "no better than chance" in text


def test_an_inconclusive_answer_says_what_is_missing() -> None:
    missing = "about 3.0x as much evidence of this kind is needed"
    text = " ".join(claim_lines(report("inconclusive", missing=missing), "s"))
    assert missing in text
    assert "neither yes nor no" in text


@pytest.mark.parametrize("verdict", ["marked", "not_marked", "inconclusive"])
def test_lines_fit(verdict: str) -> None:
    assert max(map(len, claim_lines(report(verdict), "suspect.ply"))) <= WIDTH
