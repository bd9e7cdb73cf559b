"""Pictures that do not show what the others do are left out, and no chip decides which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.watermark import picture_agreement
from engine.watermark.config import CONFIG
from engine.watermark.image_evidence import PictureEvidence
from engine.watermark.picture_agreement import Together, find_contradicting
from engine.watermark.statistics import log10_false_claim_bound

CHIPS = 2000


def said(signs: np.ndarray, seed: int, size: float = 0.5) -> PictureEvidence:
    """A picture in whose noise of deviation 1 each chip answers by `size` times its sign."""
    y = size * signs + np.random.default_rng(seed).standard_normal(CHIPS)
    response = np.full(CHIPS, size)
    return PictureEvidence(((CHIPS, 1),), np.ones(CHIPS), y, response, y, response, ())


def signs(seed: int) -> np.ndarray:
    return np.random.default_rng((7, seed)).choice([-1.0, 1.0], CHIPS)


def pictures(*marks: int) -> list[PictureEvidence]:
    """Each with the mark of that number; 0 is none."""
    return [said(signs(mark) * (mark > 0), number) for number, mark in enumerate(marks)]


def test_those_of_one_mark_stay() -> None:
    assert find_contradicting(pictures(1, 1, 1, 1)) == ()


@pytest.mark.parametrize(("marks", "odd"), [((1, 1, 0, 1), {2}), ((2, 1, 1, 1), {0}), ((1, 0, 1, 2, 1), {1, 3})])
def test_the_odd_ones_are_found(marks: tuple[int, ...], odd: set[int]) -> None:
    assert set(find_contradicting(pictures(*marks))) == odd


@pytest.mark.parametrize("marks", [(1, 0), (0, 0, 0, 0), (1, 0, 0, 0), (1, 1, 2, 2), (1, 2, 0)])
def test_without_a_majority_none_is_left_out(marks: tuple[int, ...]) -> None:
    assert find_contradicting(pictures(*marks)) == ()


def test_what_says_too_little_is_not_judged() -> None:
    small = [said(signs(1), 0), said(signs(1), 1, 0.01), said(signs(1), 2)]
    assert find_contradicting(small) == ()
    for seed in range(3, 11):
        assert find_contradicting([*pictures(1, 1), said(signs(1), seed, 0.02)]) == ()


def test_none_is_left_out_where_those_that_stay_do_not_tell() -> None:
    blank = said(0.0 * signs(1), 0)
    assert find_contradicting([blank, said(signs(1), 1, 0.2), said(signs(1), 2, 0.2)]) == ()
    faint = [said(signs(1) * (number != 2), number, 0.05) for number in range(4)]
    assert find_contradicting(faint) == ()


def test_whom_it_leaves_out_is_the_same_for_every_sign() -> None:
    """The choice sees products of two pictures alone: it stands when every chip changes its sign."""
    shown, flips = pictures(1, 1, 0, 1), signs(9)
    flipped = [
        PictureEvidence(p.parts, p.weights, flips * p.y, p.response, flips * p.held_y, p.held_response, ())
        for p in shown
    ]
    assert find_contradicting(flipped) == find_contradicting(shown) == (2,)


def test_wrong_keys_stay_below_the_bound_after_the_choice() -> None:
    shown = pictures(1, 1, 0, 1)
    odd = find_contradicting(shown)
    y = np.sum([p.held_y for number, p in enumerate(shown) if number not in odd], axis=0)
    draws = np.random.default_rng(0).choice([-1.0, 1.0], (4000, CHIPS))
    z = draws @ y / np.linalg.norm(y)
    for level in (1.0, 2.0, 3.0):
        assert (z >= level).mean() <= 10.0 ** log10_false_claim_bound(level, 1)


def test_they_are_summed_but_for_the_odd_one(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = pictures(1, 1, 0, 1)

    def together() -> tuple[PictureEvidence | None, tuple[int, ...]]:
        said = Together()
        for number, part in enumerate(shown, start=3):
            said.add(number, part)
        return said.agreed()

    total, odd = together()
    assert odd == (5,)
    assert total is not None
    np.testing.assert_allclose(total.y, shown[0].y + shown[1].y + shown[3].y)
    monkeypatch.setattr(picture_agreement, "_CONFIG", replace(CONFIG.evidence, most_kept=3 * shown[0].nbytes))
    total, odd = together()
    assert odd == ()
    assert total is not None
    np.testing.assert_allclose(total.y, sum(part.y for part in shown))
    assert Together().agreed() == (None, ())
