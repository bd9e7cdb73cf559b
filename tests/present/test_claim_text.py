"""A claim on a terminal: every line fits."""

import pytest

from engine.cli.console import WIDTH, claim_lines
from engine.present.numerals import PLAIN
from engine.present.wording import words_of
from tests.present.test_wording import report


@pytest.mark.parametrize("verdict", ["marked", "not_marked", "inconclusive"])
def test_lines_fit_and_nothing_is_lost(verdict: str) -> None:
    words = words_of(report(verdict), PLAIN, suspect="suspect.ply")
    lines = claim_lines(words)
    assert max(map(len, lines)) <= WIDTH
    text = " ".join(" ".join(lines).split())
    for part in (words.headline, words.finding, *(fact.text for fact in words.facts), *words.meaning.values()):
        assert part in text


def test_a_picture_has_room_for_less() -> None:
    words = words_of(report("marked"), PLAIN)
    lines = claim_lines(words, headline=False, parts=("says",))
    assert lines[0].startswith("This model")
    assert words.meaning["method"] not in " ".join(lines)
