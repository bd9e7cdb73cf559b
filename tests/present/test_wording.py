"""The words of a claim: nothing overstated, every verdict explained, one wording for terminal and page."""

import pytest

from engine.errors import MalformedRecordError, WrongKeyError
from engine.present.checks import CHECKS, checks_of, named
from engine.present.numerals import PLAIN, TYPOGRAPHIC, number, percent, surely, when
from engine.present.wording import Words, named_copy, words_of
from engine.watermark.rates import BASES, OWNER, Condition, ConditionKind


def report(verdict: str, **changes: object) -> dict[str, object]:
    base: dict[str, object] = {
        "verdict": verdict,
        "message": "c0ffee42",
        "matching_bits": 32,
        "bits": 32,
        "bit_reliability": [1.0] * 32,
        "tries": 2,
        "expected_z": 53.0,
        "z": 53.1,
        "log10_false_claim": -612.4,
        "false_claim_rate": 1e-9,
        "rate_basis": "drawn",
        "would_be_claim_if_attested": False,
        "power": 1.0,
        "missing": "",
        "derivation": {
            "derived": True,
            "share": 0.248,
            "gaussians": 28412,
            "exactness": 0.0021,
            "where": ((-1.0, -2.0, -3.0), (1.0, 2.0, 3.0)),
            "views": None,
        },
        "transform": None,
        "route": "model",
        "copy": "acme",
        "notes": [],
        "meets_dishonest_claimant_rate": True,
        "record_id": "ab" * 16,
        "owner": "cd" * 8,
        "registered_at": "",
        "attested": None,
    }
    return base | changes


def text_of(words: Words) -> str:
    return " ".join([words.headline, words.finding, *(fact.text for fact in words.facts), *words.meaning.values()])


@pytest.mark.parametrize(
    ("log10", "plain", "raised"),
    [
        (-3772.66, "below 10^-300", "below 10⁻³⁰⁰"),
        (-299.5, "at most 1 in 10^299", "at most 1 in 10²⁹⁹"),
        (-9.99, "at most 1 in 10^9", "at most 1 in 10⁹"),
        (-9.0, "at most 1 in 10^9", "at most 1 in 10⁹"),
        (-1.99, "at most 1 in 10^1", "at most 1 in 10¹"),
        (-0.5, "at most 32 in 100", "at most 32 in 100"),
        (-0.001, "no better than chance", "no better than chance"),
        (0.0, "no better than chance", "no better than chance"),
    ],
)
def test_odds_are_rounded_against_the_claim(log10: float, plain: str, raised: str) -> None:
    assert (PLAIN.odds(log10), TYPOGRAPHIC.odds(log10)) == (plain, raised)


def test_rates_in_words() -> None:
    assert [PLAIN.rate(p) for p in (1e-9, 2.5e-7, 0.05)] == ["1 in 10^9", "2.5 in 10^7", "5 in 10^2"]
    assert TYPOGRAPHIC.rate(1e-300) == "1 in 10³⁰⁰"


@pytest.mark.parametrize(
    ("share", "text"), [(1.0, "100 %"), (0.99999, "more than 99.9 %"), (0.248, "24.8 %"), (0.5, "50 %"), (0.0, "0 %")]
)
def test_only_the_whole_is_a_hundred_percent(share: float, text: str) -> None:
    assert percent(share) == text


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.0, 3, "0"),
        (-0.0, 3, "0"),
        (53.08, 3, "53.1"),
        (577.4, 3, "577"),
        (1234.5, 3, "1230"),
        (-48786.2, 4, "-48790"),
        (9.996, 3, "10"),
        (0.00135, 3, "0.00135"),
        (-1.2e-7, 3, "-0.00000012"),
        (1.0, 4, "1"),
        (100.0, 2, "100"),
        (float("inf"), 3, "inf"),
    ],
)
def test_numbers_have_no_exponent(value: float, digits: int, text: str) -> None:
    assert number(value, digits) == text


def test_nothing_measured_is_certain() -> None:
    assert surely(1.0) == "more than 99.9 %"
    assert surely(0.502) == "50.2 %"


def test_times_as_a_person_writes_them() -> None:
    assert when("2026-11-03T09:14:07.123456+00:00") == "3 November 2026, 09:14:07 UTC"
    assert when("in spring") == "in spring"


def test_a_marked_claim_says_all_of_it() -> None:
    text = text_of(words_of(report("marked"), PLAIN, suspect="suspect.ply"))
    for part in (
        "suspect.ply",
        "'acme'",
        "c0ffee42",
        "32/32",
        "below 10^-300",
        "z 53.1",
        "2 hypotheses",
        "1 in 10^9",
        "24.8 %",
        "28,412 Gaussians",
        "0.0021",
        "from (-1, -2, -3) to (1, 2, 3)",
        "ab" * 16,
        "2^-128",
    ):
        assert part in text, part


@pytest.mark.parametrize("verdict", ["marked", "not_marked", "inconclusive"])
def test_form_is_all_that_terminal_and_page_differ_in(verdict: str) -> None:
    plain, page = (text_of(words_of(report(verdict), form)) for form in (PLAIN, TYPOGRAPHIC))
    for ours, theirs in (("10⁻³⁰⁰", "10^-300"), ("10⁹", "10^9"), ("2⁻¹²⁸", "2^-128"), ("“acme”", "'acme'")):
        page = page.replace(ours, theirs)
    assert page == plain


@pytest.mark.parametrize(
    ("pictures", "text"), [(0, "This model contains"), (1, "This picture shows"), (3, "These pictures show")]
)
def test_the_suspect_is_called_what_it_is(pictures: int, text: str) -> None:
    assert words_of(report("marked"), PLAIN, pictures=pictures).finding.startswith(text)


def test_an_answer_that_hangs_on_the_owners_word_says_so_first() -> None:
    seen = Condition(ConditionKind.SUSPECT_SINCE, "2026-11-03", OWNER)
    for known in (seen.to_json(), seen.text):  # claims of earlier versions have sentences
        open_one = report("inconclusive", would_be_claim_if_attested=True, conditions=[known], missing="more")
        said = words_of(open_one, PLAIN).finding
        assert said.startswith("This would be a claim at 1 in 10^9 if the suspect did not exist before 2026-11-03")
        assert "the owner's word" in said
    earlier = {name: value for name, value in open_one.items() if name != "conditions"}
    assert "older than the suspect, which nobody has attested" in words_of(earlier, PLAIN).finding


def test_a_weak_claim_says_why_it_counts() -> None:
    weak = report("marked", meets_dishonest_claimant_rate=False)
    assert BASES["drawn"] in words_of(weak, PLAIN).meaning["record_time"]


def test_a_strong_claim_does_not_take_the_thief_s_side() -> None:
    """Whoever marks a stolen model has a true mark in it: no bound says who was first."""
    for date in ("", "2020-01-01"):
        text = text_of(words_of(report("marked", registered_at=date), PLAIN))
        assert "does not say who was first" in text
        assert "dispute" in text
        for wrong in ("stands even", "needs no trust", "disputed", "forger"):
            assert wrong not in text


def test_dates_are_called_what_they_are() -> None:
    own = report("marked", registered_at="2026-11-03T09:14:07+00:00")
    assert "registered 3 November 2026, 09:14:07 UTC (self-declared)" in text_of(words_of(own, PLAIN))
    attested = {"at": "2026-11-04T00:00:00+00:00", "by": "the log of this service", "drawn": True}
    text = text_of(words_of({**own, "attested": attested}, PLAIN))
    assert "registered by 4 November 2026, 00:00:00 UTC (attested by the log of this service)" in text
    assert "self-declared" in text
    assert "not dated" in text_of(words_of(report("marked"), PLAIN))


def test_which_rate_applied_and_why() -> None:
    strict = report("marked", false_claim_rate=2.0**-128, rate_basis="self_declared")
    text = text_of(words_of(strict, PLAIN))
    assert "1 in 2^128" in text
    assert BASES["self_declared"] in text
    ((bar, _),) = words_of(strict, PLAIN).limits
    assert round(bar, 2) == -38.53
    between = report("inconclusive", would_be_claim_if_attested=True, missing="more", rate_basis="self_declared")
    assert words_of(between, PLAIN).finding.startswith("This would be a claim at 1 in 10^9 if")


def test_what_equals_the_original_is_called_that_and_acquits_nobody() -> None:
    words = words_of(report("not_marked", log10_false_claim=0.0, change=0.04), PLAIN, suspect="s")
    assert words.finding.startswith("s equals your unmarked original")
    assert "computed from one or more marked copies" in words.finding
    assert "your watermark was not detected" in words.finding
    text = text_of(words)
    assert "not acquit" in text
    assert "removed" not in text
    assert "no better than chance" in text
    check = {each["code"]: each for each in checks_of(report("not_marked"), None)}
    assert (check["derived"]["ok"], check["mark"]["ok"]) == (True, False)


@pytest.mark.parametrize(("named", "z"), [(True, 70.0), (False, 0.3), (None, None)])
def test_a_copy_is_named_where_it_was_read(named: bool | None, z: float | None) -> None:
    """The owner's layer is in all copies: a claim that rests on it names none by itself."""
    words = words_of(report("marked", copy="acme", copy_named=named, copy_z=z), PLAIN)
    assert ("the copy made for 'acme'" in words.finding) == (named is not False)
    (copy,) = [fact.text for fact in words.facts if fact.label == "copy"]
    assert ("not shown to be the copy" in copy) == (named is False)


def test_without_a_mark_no_copy_is_named() -> None:
    """The evidence may be the same for the records of all copies."""
    claim = report("inconclusive", copy="acme")
    assert named_copy(claim) == ""
    assert "acme" not in words_of(claim, PLAIN).finding
    assert next(fact.text for fact in words_of(claim, PLAIN).facts if fact.label == "copy").endswith("no copy is named")


NOTHING = {"derived": False, "share": 0.0, "gaussians": 0, "exactness": None, "where": None, "views": None}


def test_where_nothing_was_found_nothing_is_said() -> None:
    words = words_of(report("inconclusive", derivation=NOTHING, missing="more"), PLAIN, suspect="s")
    assert "derived" not in words.finding
    assert words.headline == "Not recognized"
    checks = checks_of(report("inconclusive", derivation=NOTHING, missing="more"), None)
    assert [check["ok"] for check in checks] == [True, True, None, None, False]


def test_derivation_stands_where_the_mark_is_undecided() -> None:
    words = words_of(report("inconclusive", missing="more"), PLAIN, suspect="s")
    assert words.finding.startswith("s is derived from your asset.")
    assert "derived from your asset" in words.meaning["says"]


def test_an_inconclusive_answer_says_what_is_missing() -> None:
    missing = "about 3.0x as much evidence of this kind is needed"
    text = text_of(words_of(report("inconclusive", missing=missing, derivation=NOTHING), PLAIN))
    assert missing in text
    assert "no proof" in text


def test_leading_facts_come_first() -> None:
    leading = [fact.leading for fact in words_of(report("not_marked"), PLAIN).facts]
    assert leading == sorted(leading, reverse=True)


def test_a_record_that_does_not_open_leaves_the_rest_unchecked() -> None:
    wrong, broken = checks_of(None, WrongKeyError("x")), checks_of(None, MalformedRecordError("cut short"))
    assert [check["ok"] for check in wrong] == [True, False, None, None, None]
    assert [check["ok"] for check in broken] == [False, None, None, None, None]
    assert [check["code"] for check in wrong] == list(CHECKS)
    assert (named(wrong)[1]["name"], named(wrong)[1]["outcome"]) == ("Owner's key", "does not hold")


def test_a_mirror_is_said() -> None:
    moved = {"scale": 0.5, "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation": [0, 0, 0]}
    for mirrored, said in ((True, "mirrored, scaled by 2"), (False, "scaled by 2"), (None, "scaled by 2")):
        transform = moved if mirrored is None else moved | {"mirrored": mirrored}  # older claims do not say
        facts = words_of(report("marked", transform=transform), PLAIN).facts
        assert next(fact.text for fact in facts if fact.label == "moved").startswith(said)


def test_pictures_without_the_asset_decide_nothing() -> None:
    for shown, ok in ((0, None), (1, True)):
        derivation = {**NOTHING, "derived": shown > 0, "share": None, "views": (shown, 2)}
        seen = report("inconclusive", derivation=derivation, missing="more")
        assert [check["ok"] for check in checks_of(seen, None)] == [True, True, ok, None, False]
    assert "1 of 2 pictures" in checks_of(seen, None)[2]["text"]
