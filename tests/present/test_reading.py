"""The answer of a verification: bits where some were read, the reason where none were, and a strength that grows."""

from __future__ import annotations

import json
from typing import Any

import pytest

from engine.present.numerals import PLAIN
from engine.present.reading import reading_of
from engine.present.wording import words_of
from tests.present.test_wording import report

REGISTERED = "c0ffee42"


def read(verdict: str = "marked", **changes: Any) -> dict[str, Any]:
    claim = report(verdict, confidence=1.0, derived_fraction=0.248, **changes)
    plain = reading_of(claim, REGISTERED).to_json()
    assert json.loads(json.dumps(plain)) == plain
    return plain


def underived(**changes: Any) -> dict[str, Any]:
    nothing = dict.fromkeys(("share", "gaussians", "exactness", "where", "views"))
    return read("inconclusive", derivation=nothing | {"derived": False}, **changes)


def test_a_mark_is_handed_out_bit_by_bit() -> None:
    plain = read(bit_reliability=[0.99] * 31 + [0.6], message="c0ffee43")
    string = "11000000111111111110111001000011"
    assert plain["bits"] == {"hex": "c0ffee43", "string": string}
    assert plain["registered_bits"] == {"hex": REGISTERED, "string": f"{string[:-1]}0"}
    assert (plain["matching"], plain["bit_accuracy"], plain["reliability"][-1]) == (31, 31 / 32, 0.6)
    assert (plain["z"], plain["hypotheses"], plain["no_bits"]) == (53.1, 2, None)
    assert plain["headline"] == "Watermark found"


def test_a_bit_that_was_not_read_is_no_zero() -> None:
    plain = read(bit_reliability=[0.5] + [0.99] * 31)
    assert plain["bits"] == {"hex": None, "string": "?1000000111111111110111001000010"}
    assert (plain["matching"], plain["bit_accuracy"]) == (31, 31 / 32)


@pytest.mark.parametrize(
    "plain",
    [underived(), read("inconclusive", bit_reliability=[0.5] * 32), underived(message=None, z=None)],
    ids=["not recognized", "says nothing", "not compared"],
)
def test_where_nothing_was_read_there_is_a_reason_and_no_bits(plain: dict[str, Any]) -> None:
    assert [plain[name] for name in ("bits", "matching", "bit_accuracy", "reliability")] == [None] * 4
    assert plain["no_bits"]


def test_words_and_answer_agree_on_what_was_not_read() -> None:
    for claim in (report("inconclusive", bit_reliability=[0.5] * 32), report("marked")):
        reading = reading_of(claim | {"confidence": 1.0, "derived_fraction": None}, REGISTERED)
        (fact,) = [fact.text for fact in words_of(claim, PLAIN).facts if fact.label == "message read"]
        assert fact.startswith("none: ") == (reading.bits is None)


@pytest.mark.parametrize(("log10", "bits"), [(0.0, 0.0), (-9.0, 29.897), (-38.532, 128.0), (-3067.5, 10190.01)])
def test_strength_is_the_bound_in_bits(log10: float, bits: float) -> None:
    assert read(log10_false_claim=log10)["strength"] == pytest.approx(bits, abs=0.01)
