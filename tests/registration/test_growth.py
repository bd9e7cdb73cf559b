"""Rows known to be partners, whose errors grow with their size: believed one by one, with no second search."""

from __future__ import annotations

import numpy as np
import pytest

from engine.model import GaussianModel
from engine.numerics.umeyama import Similarity
from engine.registration import agreement
from engine.registration import registration_search as registering
from engine.registration.agreement import growth_in_order, same_order
from engine.registration.config import CONFIG
from engine.registration.looks_index import ReferenceIndex
from engine.registration.registration_search import register
from tests.registration.registration_cases import marked
from tests.registration.test_classes import shaken, wide

SAME = Similarity.identity()


def growth(suspect: GaussianModel, alike: np.ndarray) -> np.ndarray:
    return growth_in_order(wide(), suspect, SAME, alike).parts


def test_growth_is_learnt_from_what_looks_alike_and_lies_near() -> None:
    model = wide()
    everything = np.ones(len(model), bool)
    parts = growth(shaken(marked(model), 0.3), everything)
    assert len(parts) == CONFIG.classes.count
    assert (parts > 0.15).all()  # along the longest axis 0.3 of the size, along the others less
    assert (parts < 0.3).all()
    assert (growth(marked(model), everything) == 0.0).all()
    # What lies farther than a Gaussian is large is another; nor is anything learnt from none.
    away = marked(model)
    shift = 2.0 * CONFIG.classes.own_size * np.exp(away.log_scales.max(axis=1, keepdims=True))
    gone = away.with_(means=(away.means + shift).astype(np.float32))
    assert (growth(gone, everything) == 0.0).all()
    assert (growth(shaken(marked(model), 0.3), ~everything) == 0.0).all()


def test_large_ones_are_trusted_and_nothing_is_searched_again(monkeypatch: pytest.MonkeyPatch) -> None:
    model = wide()
    suspect = shaken(marked(model), 0.04)

    def never(*_: object, **__: object) -> None:
        raise AssertionError("the reference was laid out for another search")

    monkeypatch.setattr(registering, "by_size", never)
    monkeypatch.setattr(agreement, "Matcher", never)
    got = register(model, suspect)
    np.testing.assert_array_equal(got.matches, np.arange(len(model)))
    largest = np.argsort(model.log_scales.max(axis=1))[-len(model) // 100 :]
    assert got.match_quality[largest].mean() > 0.9


@pytest.mark.parametrize(("share", "sought"), [(0.5 * CONFIG.order.strays, False), (0.02, True)])
def test_a_few_strays_are_let_go(share: float, sought: bool) -> None:
    model = wide()
    rng = np.random.default_rng(1)
    means = marked(model).means.copy()
    gone = rng.choice(len(model), max(1, round(share * len(model))), replace=False)
    means[gone] += 30.0
    index = ReferenceIndex(model)
    found = same_order(model, marked(model).with_(means=means), index.floor, rng)
    assert found is not None
    assert found.order_quality is not None
    assert (found.order_quality[gone] == 0).all()
    assert (found.matcher is not None) == sought


def test_rows_that_are_no_partners_are_not_believed_however_much_errors_grow() -> None:
    """Half of the order was lost: what takes a row's place does not look like it."""
    model = wide()
    half = np.arange(len(model))
    half[::2] = np.random.default_rng(2).permutation(half[::2])
    got = register(model, shaken(marked(model), 0.3).take(half))
    assert ((got.matches >= 0) & (got.matches != half)).mean() < 0.005
    assert (got.matches == half).mean() > 0.95
